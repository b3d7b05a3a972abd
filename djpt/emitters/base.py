"""The contract of emitters."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from djpt.description.numeric import non_negative
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.emitters.bounds import LightBounds
from djpt.records import DirectionSample3f, EmissionSample, EmitterFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, Vector3f

__all__ = ["Emitter"]


class Emitter(Plugin):
    """A source of light: radiance along a ray, and a way to sample directions towards it.

    All methods run in kernels, once per class, with per-lane values (see `djpt.dispatch.ensemble`).
    Densities are per unit solid angle at the reference point.

    Parameters of all emitters: `sampling_weight` (default 1).
    """

    kind: ClassVar[str] = "emitter"
    on_shape: ClassVar[bool] = False
    """Must it be nested in a shape? The scene then sets `shape`."""
    shape: Any = None

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.sampling_weight = props.float("sampling_weight", 1.0, low=0.0)

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("sampling_weight", self.sampling_weight)
        super().traverse(callback)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "sampling_weight":
            return non_negative(value)
        return super().check_parameter(name, value)

    def flags(self) -> int:
        """The `EmitterFlags`."""
        return int(EmitterFlags.Empty)

    @property
    def from_infinity(self) -> bool:
        """True if its light arrives from beyond the scene."""
        flags = self.flags()
        beyond = has_flag(flags, EmitterFlags.Infinite) or has_flag(flags, EmitterFlags.DeltaDirection)
        return bool(beyond) and not self.on_shape

    # ---- on the host -------------------------------------------------------------------

    def set_bounds(self, center: NDArray[np.float64], radius: float) -> None:
        """Called with the scene's bounding sphere, and again when it changes; for light from infinity."""

    def power(self) -> float:
        """The light that it sends out, in W, averaged over the colours.

        For light from infinity: what enters the scene's bounding sphere. An estimate will do: it guides
        the choice of emitters (see `djpt.emitters.choice`).
        """
        raise NotImplementedError

    def bounds(self) -> LightBounds | None:
        """Where its light comes from and goes to; None for light from infinity."""
        raise NotImplementedError

    # ---- in kernels --------------------------------------------------------------------

    shares_lookup: ClassVar[bool] = False
    """Environments: is `eval_or_sample` there, and faster than the methods that it stands for?"""

    def eval_or_sample(
        self, si: SurfaceInteraction3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[Color3f, Float, Float, Vector3f]:
        """Where `si` is a miss: the environment along the ray. Elsewhere: a sampled direction.

        Radiance, density per unit solid angle, the inverse of that, and the direction (unspecified on a miss).
        Lanes that aren't `active` need no sample.
        """
        raise NotImplementedError

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """Radiance that leaves `si` (for an environment: that arrives along the missing ray) towards `si.wi`."""
        raise NotImplementedError

    def sample_direction(
        self, ref: Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """A direction towards the emitter and the radiance (or intensity / dist^2) over its density.

        Visibility isn't considered. The weight is 0 where nothing can arrive.
        """
        raise NotImplementedError

    def pdf_direction(self, ref: Point3f, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """Density of `sample_direction` at `ds`; 0 for delta emitters."""
        raise NotImplementedError

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

    def sample_ray(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray that leaves the emitter: ray and weight of `sample_emission` (Mitsuba's method)."""
        es = self.sample_emission(position_sample, direction_sample, active)
        return es.ray, es.weight
