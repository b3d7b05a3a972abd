"""The contract of volumes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

from drjit.scalar import Array3f as ScalarPoint3f
from drjit.scalar import Array3i as ScalarArray3i

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.transforms import ScalarTransform4f
from djpt.description.plugin import NotMovable, Plugin
from djpt.description.properties import Allowed, Properties
from djpt.dispatch.scripted import accept_scripts
from djpt.errors import RenderError
from djpt.jit.types import Bool, Color3f, Float, Vector3f

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Volume"]


class Volume(Plugin):
    """Numbers or colours in space. By default they fill the unit cube [0, 1]^3, which `to_world` moves.

    The eval methods run in kernels, once per class, with per-lane values (see `djpt.dispatch.ensemble`). `it` is
    anything with a point `p` in world space, such as a medium interaction.

    Parameters of all volumes: `to_world`, an affine map (default: the identity).
    """

    kind: ClassVar[str] = "volume"
    is_constant: ClassVar[bool] = False
    """True if the volume is the same everywhere."""

    @property
    def is_grey(self) -> bool:
        """True if `eval` gives three equal numbers wherever it is asked, now and after edits."""
        return False

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.to_world = props.transform("to_world")

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        accept_scripts(cls, Volume, CONVERSIONS)

    # ---- working frames ----------------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        """By default only what is the same everywhere can be moved."""
        if not self.is_constant:
            raise NotMovable(f"{self.id()}: its variation in space is unknown")
        self.move_nested(frame)

    # ---- on the host -------------------------------------------------------------------

    def bbox(self) -> ScalarBoundingBox3f:
        """The smallest box along the axes of the world that holds the volume."""
        box = ScalarBoundingBox3f()
        for corner in itertools.product((0.0, 1.0), repeat=3):
            box.expand(ScalarPoint3f(self.placement().transform_point(corner)))
        return box

    def placement(self) -> ScalarTransform4f:
        """The map from the unit cube to the world."""
        return self.to_world

    def channel_count(self) -> int:
        """The count of numbers at a point; 0 if it isn't known, as for constants."""
        return 0

    def max(self) -> float:
        """The largest number of all points and channels."""
        raise self.unknown("no largest value")

    def max_per_channel(self) -> list[float]:
        """The largest number of each channel."""
        raise self.unknown("no largest values by channel")

    def mean(self) -> Float:
        """The average of `eval_1` over the volume; an estimate is enough, for choices that sampling makes."""
        raise self.unknown("no mean")

    def resolution(self) -> ScalarArray3i:
        """The number of grid points along x, y and z; 1 along each for volumes without a grid."""
        return ScalarArray3i(1, 1, 1)

    def restrict(self, allowed: Allowed, where: str) -> None:
        """Require that all numbers are `allowed`, now and after each edit; `where` starts the message.

        By default nothing is checked, as the numbers of a script's volume aren't known.

        Raises:
            SceneError: a number lies outside.
        """

    def unknown(self, what: str) -> RenderError:
        """The error of a question that the volume has no answer to."""
        return RenderError(f"{self.id()}: a '{type(self).__name__}' has {what}")

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, it: Any, active: Bool | bool = True) -> Color3f:
        """The colour at `it.p`; a single number is a grey."""
        raise self.unknown("no colours")

    def eval_1(self, it: Any, active: Bool | bool = True) -> Float:
        """The number at `it.p`."""
        raise self.unknown("no single numbers")

    def eval_3(self, it: Any, active: Bool | bool = True) -> Vector3f:
        """The three numbers at `it.p`."""
        raise self.unknown("no three numbers")

    def eval_6(self, it: Any, active: Bool | bool = True) -> list[Float]:
        """The six numbers at `it.p`, such as the parameters of an SGGX phase function."""
        raise self.unknown("no six numbers")

    def eval_n(self, it: Any, active: Bool | bool = True) -> list[Float]:
        """The numbers of all channels at `it.p`."""
        raise self.unknown("no channels")

    def eval_gradient(self, it: Any, active: Bool | bool = True) -> tuple[Color3f, Vector3f]:
        """The colour at `it.p`, and the derivative of its mean by the point."""
        raise self.unknown("no derivatives")

    def pick(self, it: Any, u: Float, active: Bool | bool = True) -> Color3f:
        """An estimate of `eval`, whose mean over uniform `u` in [0, 1) is the exact value.

        A grid reads one of the eight entries around the point in place of all.
        """
        return self.eval(it, active)

    def pick_1(self, it: Any, u: Float, active: Bool | bool = True) -> Float:
        """An estimate of `eval_1`, like `pick`."""
        return self.eval_1(it, active)


def as_numbers(found: Any) -> list[Float]:
    """Convert the channels that a script's volume returns."""
    return [Float(x) for x in found]


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "eval": Color3f,
    "eval_1": Float,
    "eval_3": Vector3f,
    "eval_6": as_numbers,
    "eval_n": as_numbers,
    "eval_gradient": lambda found: (Color3f(found[0]), Vector3f(found[1])),
}
