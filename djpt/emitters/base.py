"""The contract of emitters, and bases for those that are points or infinitely far away."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import non_negative
from djpt.core.records import (
    DirectionSample3f,
    EmissionSample,
    EmitterFlags,
    Observer,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.description.plugin import NotMovable, TraversalCallback
from djpt.description.properties import Properties
from djpt.emitters.mitsuba_api import EmitterQuestions
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["DeltaEmitter", "Emitter", "InfiniteEmitter", "LightBounds", "beam"]


@dataclass(frozen=True)
class LightBounds:
    """A box that holds the emitter, and a cone that holds the directions of its light.

    The normals of what shines lie within `theta_o` of `axis`, and light leaves within `theta_e` of a
    normal (A. Conty Estevez and C. Kulla, "Importance Sampling of Many Lights with Adaptive Tree
    Splitting", 2018). World space; angles in radians.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    axis: NDArray[np.float64]
    """The cone's axis, of unit length."""
    theta_o: float
    theta_e: float
    power: float
    """The emitted power in W, an estimate: see `Emitter.power`."""


class Emitter(EmitterQuestions):
    """A source of light: its radiance, and ways to sample directions towards it and rays that leave it.

    The methods under "in kernels" are traced once per class, with per-lane values (see `djpt.dispatch.ensemble`).

    Parameters of all emitters: `sampling_weight` (default 1).
    """

    kind: ClassVar[str] = "emitter"
    on_shape: ClassVar[bool] = False
    """True if it must be nested in a shape; the scene then sets `shape`."""
    in_time: ClassVar[bool] = False
    """True if the light depends on the time of a ray: rays of cameras then have one."""
    motions: ClassVar[tuple[str, ...]] = ()
    """The values that say where the light is and where it points to, of those that may have gradients."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.share = props.float("sampling_weight", 1.0, low=0.0)
        self._medium = props.child("medium")

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.share, attribute="share")
        if self._medium is not None:
            callback.put("medium", self._medium)
        super().traverse(callback)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "sampling_weight":
            return non_negative(value)
        return super().check_parameter(name, value)

    def flags(self, active: Bool | bool = True) -> int:
        """The kind of emitter: `EmitterFlags`, combined."""
        return int(self.m_flags)

    @property
    def from_infinity(self) -> bool:
        """True if its light arrives from beyond the scene."""
        flags = self.flags()
        beyond = has_flag(flags, EmitterFlags.Infinite) or has_flag(flags, EmitterFlags.DeltaDirection)
        return bool(beyond) and not self.on_shape

    def is_moving(self) -> bool:
        """Whether what places the light has gradients, also where these are suspended."""
        with dr.resume_grad():
            return any(dr.grad_enabled(getattr(self, name)) for name in self.motions)

    # ---- working frames ----------------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        """By default light from infinity or from a shape has no place or length of its own; no other can be moved."""
        if not (self.from_infinity or self.on_shape):
            raise NotMovable(f"{self.id()}: its place is unknown")
        self.move_nested(frame)

    def move_nested(self, frame: Frame) -> None:
        # Some emitters list it as a child, too.
        shape = frame.copy_of(self.shape)
        super().move_nested(frame)
        self.shape = shape

    # ---- on the host -------------------------------------------------------------------

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        """Take the scene's bounding sphere, once and whenever it changes: light from infinity enters through it."""

    def power(self) -> float:
        """The power of the emitted light in W, averaged over the colours.

        For light from infinity: what enters the scene's bounding sphere. An estimate will do, since it
        guides the choice of emitters (see `djpt.emitters.light_samplers`).
        """
        raise NotImplementedError

    def bounds(self) -> LightBounds | None:
        """Bounds of the light's origins and directions; None for light from infinity."""
        raise NotImplementedError

    def bounds_in_time(self) -> LightBounds | None:
        """Bounds at all times, of a light that moves."""
        still, motion = self.bounds(), self.carrier
        if still is None or motion is None:
            return still
        low, high = motion.keyframes.box(still.low, still.high)
        return replace(still, low=low, high=high, theta_o=math.pi)

    # ---- in kernels --------------------------------------------------------------------

    shares_lookup: ClassVar[bool] = False
    """True if the emitter is an environment whose `eval_or_sample` is faster than the methods that it stands for."""

    def eval_or_sample(
        self, si: SurfaceInteraction3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[Color3f, Float, Float, Vector3f]:
        """Look up the environment where `si` is a miss; sample a direction towards it elsewhere.

        Returned are the radiance, the density of `sample_direction` (per unit solid angle), its inverse, and the
        direction in world space (unspecified on a miss). Lanes that aren't `active` need no sample.
        """
        raise NotImplementedError

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The radiance that leaves `si` towards `si.wi`; of an environment, what arrives along the ray that missed."""
        raise NotImplementedError

    def sample_direction(
        self, it: Observer, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """Sample a direction from the point `it` towards the emitter, with its weight.

        The weight is the radiance over the density per unit solid angle; of a point, intensity / dist^2; of parallel
        light, irradiance. It is 0 where nothing can arrive. Visibility isn't considered.
        """
        raise NotImplementedError

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction` at `ds`, per unit solid angle at `it`; 0 for delta emitters."""
        raise NotImplementedError

    def eval_and_pdf(
        self, si: SurfaceInteraction3f, it: Observer, ds: DirectionSample3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """`eval` at `si`, which a ray from `it` has met, and `pdf_direction` of that ray, which `ds` describes."""
        return self.eval(si, active), self.pdf_direction(it, ds, active)

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        """Sample a ray that leaves the emitter, with its weight and densities.

        The mean of the weight is the emitter's power. The ray carries no offset from the surface.

        Raises:
            SceneError: the emitter is on a shape whose area isn't known.
        """
        raise NotImplementedError

    def pdf_emission(self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True) -> tuple[Float, Float]:
        """The densities (pdf_position, pdf_direction) of `sample_emission` at a ray that leaves the emitter.

        For paths that meet the emitter in another way. `d` is the ray's direction, of unit length; `n` the normal of
        the side that shines and `uv` the texture coordinates at the ray's origin. A `DirectionSample3f` ds, sampled
        or `between` a point and a hit, gives them as -ds.d, ds.n and ds.uv.

        Measures are those of `EmissionSample`. The product is 0 for rays that are never drawn, except that deltas
        aren't tested: their density is 1 whatever the arguments, which must describe a ray that exists.

        Raises:
            SceneError: the emitter is on a shape whose area isn't known.
        """
        raise NotImplementedError


class DeltaEmitter(Emitter):
    """A light that no ray meets and no density finds: only its own samples lead to it."""

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return Color3f(0)

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        return Float(0)


class InfiniteEmitter(Emitter):
    """Light from infinity: it enters through the sphere about the scene, whose `center` and `radius` kernels read."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.set_bounds(np.zeros(3), 1.0)

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        if self.motion is not None:
            # It turns about the origin: a sphere that holds the scene however it is turned.
            center, radius = np.zeros(3), radius + float(np.linalg.norm(center))
        self.center, self.radius = as_vector(center), as_float(radius)

    def bounds(self) -> LightBounds | None:
        return None

    @staticmethod
    def towards(it: Observer, d: Vector3f, uv: Point2f, pdf: Float, weight: Float) -> DirectionSample3f:
        """The sample of the direction `d` from `it`, with its density and the inverse of that."""
        # The point is a stand-in for that at infinity; visibility rays use `d` (see `Scene.shadow_ray`).
        return DirectionSample3f.of(it.p + d, -d, uv, d, Float(dr.inf), pdf, weight, Bool(False), UInt32(0))


def beam(
    ray: Ray3f,
    weight: Color3f,
    pdf_position: Float,
    pdf_direction: Float,
    uv: Point2f | None = None,
    finite: bool = False,
    delta: bool = False,
) -> EmissionSample:
    """The `EmissionSample` of light that leaves straight through what it starts at.

    `uv` is the place in the light's picture, if it throws one.
    """
    return EmissionSample(
        ray=ray,
        weight=weight,
        n=ray.d,
        uv=Point2f(0) if uv is None else uv,
        cos=Float(1),
        pdf_position=pdf_position,
        pdf_direction=pdf_direction,
        finite=Bool(finite),
        delta=Bool(delta),
    )
