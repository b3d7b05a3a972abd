"""Animated transforms: keyframes with parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.numeric import as_array, as_number, describe
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.core.transforms.keyframes import Keyframes, MotionTable, Placement, attached_placement
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import Float, TensorXf

__all__ = ["AnimatedTransform4f"]

PARTS = {"times": 1, "scale": 3, "rotation": 4, "translation": 3}
"""The parameters, with the numbers of each at a keyframe."""
MOVES = ParamFlags.Differentiable | ParamFlags.Discontinuous


class AnimatedTransform4f(Plugin):
    """A transform that changes in time: keyframes between which its parts are interpolated.

    A keyframe x -> R S x + T is taken apart into scale S, rotation R and translation T. Scale and translation are
    linear between keyframes; the rotation turns at constant speed along the shortest way, so one of more than half a
    turn needs keyframes between. Before the first and after the last keyframe nothing moves.

    Args:
        keyframes: A dict of transforms by time, or pairs (time, transform), in any order; another animation. The unit
            of time is that of the sensors' `shutter_open`.

    Raises:
        SceneError: There are fewer than two keyframes, two of one time, or one that shears.

    As the `to_world` of a shape, an instance, an emitter or a sensor it moves what it belongs to; everything with the
    same object moves together. Parameters, N keyframes: `times` (N,), `scale` (N, 3), `rotation` (N, 4), unit
    quaternions (x, y, z, w), and `translation` (N, 3).
    """

    kind = "animation"
    in_any_frame = False

    times: Any
    scale: Any
    rotation: Any
    translation: Any

    def __init__(self, keyframes: Mapping[float, Any] | Sequence[tuple[float, Any]] | AnimatedTransform4f) -> None:
        super().__init__()
        self.set_id("animation")
        self._demands: dict[str, str] = {}
        """What must be true of the keyframes, and why: properties `is_rigid`, `is_similar`, `is_unmirrored`."""
        if isinstance(keyframes, AnimatedTransform4f):
            self._take(keyframes.keyframes)
            return
        pairs = list(keyframes.items()) if isinstance(keyframes, Mapping) else list(keyframes)
        try:
            found = [(as_number(time), as_transform(transform)) for time, transform in pairs]
        except (TypeError, ValueError):
            raise SceneError(
                f"an animation is made of a dict of transforms by time, or of pairs, found {describe(keyframes)}"
            ) from None
        self._take(Keyframes.of(found))

    def _take(self, keyframes: Keyframes) -> None:
        """Take over keyframes, with parameters of their values."""
        self.keyframes = keyframes
        for name in PARTS:
            setattr(self, name, TensorXf(np.asarray(getattr(keyframes, name), np.float32)))
        self._table = MotionTable(keyframes)

    # ---- parameters ----------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        for name in PARTS:
            callback.put(name, getattr(self, name), MOVES)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Follow an edit of keyframes.

        Raises:
            ParameterError: The parts contradict each other, or can't be interpolated.
        """
        parts = {}
        count = dr.detach(self.times).shape[0]
        for name, width in PARTS.items():
            numbers = as_array(dr.detach(getattr(self, name))).astype(np.float64)
            if numbers.size != count * width:
                raise ParameterError(
                    f"{self.id()}.{name}: {count} keyframes need {count * width} numbers, found {numbers.size}; "
                    "to change their number assign all four parameters"
                )
            parts[name] = numbers.reshape(count, width) if width > 1 else numbers.ravel()
        try:
            keyframes = Keyframes.checked(**parts)
            meet(self._demands, keyframes)
        except SceneError as error:
            raise ParameterError(f"{self.id()}: {error}") from None
        self.keyframes, self._table = keyframes, MotionTable(keyframes)

    def demand(self, what: str, why: str) -> None:
        """Require that the keyframes are, and remain, `rigid`, `similar` or `unmirrored`; `why` is the message.

        Raises:
            SceneError: They aren't.
        """
        meet({what: why}, self.keyframes)
        self._demands[what] = why

    def is_attached(self) -> bool:
        """Whether some of the keyframes have gradients, also where these are suspended."""
        with dr.resume_grad():
            return any(dr.grad_enabled(getattr(self, name)) for name in PARTS)

    # ---- questions -----------------------------------------------------------------------

    def placement(self, time: Float) -> Placement:
        """The map from the own space of what moves to the world at a time, per lane; without gradients."""
        return self._table.at(time)

    def attached_matrix_at(self, time: float, moment: Float | None = None) -> Any:
        """The matrix at one moment, a `Matrix4f` attached to the keyframes, and to the time if `moment` gives it."""
        order = np.argsort(as_array(dr.detach(self.times)).ravel(), kind="stable")

        def part(name: str, k: int) -> list[Float]:
            tensor, width, row = getattr(self, name), PARTS[name], int(order[k])
            return [dr.gather(Float, tensor.array, row * width + i) for i in range(width)]

        return attached_placement(time, self.keyframes.times.tolist(), part, moment).matrix()

    def eval(self, time: Any) -> Any:
        """The transform at a time, an `AffineTransform4f` per lane."""
        from djpt.core.transforms.lanes import AffineTransform4f  # the renderer needs none

        return AffineTransform4f(self.placement(Float(time)).matrix())

    def eval_scalar(self, time: float) -> ScalarTransform4f:
        """The transform at a time, on the host."""
        return self.keyframes.at(as_number(time))

    def has_scale(self) -> bool:
        """Whether a keyframe changes lengths."""
        return not self.keyframes.is_rigid

    def get_time_bounds(self) -> tuple[float, float]:
        """The times of the first and of the last keyframe."""
        return float(self.keyframes.times[0]), float(self.keyframes.times[-1])

    def get_translation_bounds(self) -> ScalarBoundingBox3f:
        """The box about the images of the origin."""
        places = self.keyframes.translation
        return ScalarBoundingBox3f(places.min(axis=0), places.max(axis=0))

    def get_spatial_bounds(self, bbox: Any) -> ScalarBoundingBox3f:
        """A box that holds another one at all times."""
        low, high = self.keyframes.box(as_array(bbox.min), as_array(bbox.max))
        return ScalarBoundingBox3f(low, high)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, AnimatedTransform4f):
            return NotImplemented
        return self.keyframes == other.keyframes

    __hash__ = Plugin.__hash__


def meet(demands: Mapping[str, str], keyframes: Keyframes) -> None:
    """Raise `SceneError` if keyframes lack a demanded property; its value is the message."""
    for what, why in demands.items():
        if not getattr(keyframes, f"is_{what}"):
            raise SceneError(why)
