"""Queries of single emitters by scripts, with Mitsuba's arguments."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.frame import Frame3f
from djpt.core.records import (
    DirectionSample3f,
    EmitterFlags,
    Interaction3f,
    Observer,
    PositionSample3f,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.core.records.record import Wavelengths
from djpt.description.plugin import Endpoint
from djpt.errors import SceneError
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f

__all__ = ["EmitterQuestions"]


class EmitterQuestions(Endpoint):
    """The part of an emitter that the renderer doesn't need."""

    m_flags: int = int(EmitterFlags.Empty)
    """The result of `flags` unless it is overridden; scripts written for Mitsuba set it."""

    share: float = 1.0
    """The parameter `sampling_weight`."""

    def sampling_weight(self) -> float:
        """The relative probability with which light sampling chooses the emitter."""
        return self.share

    def is_environment(self) -> bool:
        """True if the emitter surrounds the scene: rays that miss everything see it."""
        flags = self.flags()  # type: ignore[attr-defined]
        return bool(has_flag(flags, EmitterFlags.Infinite) and not has_flag(flags, EmitterFlags.Delta))

    def stand_alone(self) -> None:
        # As in Mitsuba: a sphere of radius 1 about the origin until a scene is known.
        self.set_bounds(np.zeros(3), 1.0)

    def bbox(self) -> ScalarBoundingBox3f:
        """The box about the shape or the point that light comes from, at all times; empty for light from infinity."""
        if self.shape is not None:
            return self.shape.bbox()
        is_infinite = has_flag(self.flags(), EmitterFlags.Infinite)  # type: ignore[attr-defined]
        if not is_infinite and hasattr(self, "position"):
            at = np.array(dr.detach(self.position), np.float64).ravel()
            box = ScalarBoundingBox3f(at, at)
            return box if self.motion is None else self.motion.get_spatial_bounds(box)
        return ScalarBoundingBox3f(np.full(3, np.inf), np.full(3, -np.inf))

    def eval_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """The light that arrives at `it` from the point of `ds`, whatever stands between.

        That is the radiance; of a point, intensity / dist^2; of parallel light, the irradiance.
        """
        delta = EmitterFlags.DeltaPosition | EmitterFlags.DeltaDirection
        if has_flag(self.flags(), delta):  # type: ignore[attr-defined]
            return self.sample_direction(it, Point2f(0.5), active)[1]
        frame = Frame3f.from_normal(ds.n)
        time = it.time if isinstance(it, Interaction3f) else ds.time
        si = SurfaceInteraction3f(p=ds.p, n=ds.n, uv=ds.uv, sh_frame=frame, time=time)
        if self.is_environment():
            si.wi = -ds.d
        else:
            si.t, si.wi = ds.dist, frame.to_local(-ds.d)
        return dr.select(active, self.eval(si, active), 0)

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray that leaves the emitter; the mean of the weight is its power.

        `sample1` would choose a wavelength; `sample2` and `sample3` are numbers in the unit square for the position
        and the direction. The ray carries no offset from the surface.
        """
        es = self.sample_emission(Point2f(sample2), Point2f(sample3), active)  # type: ignore[attr-defined]
        es.ray.time = Float(time)
        return es.ray, es.weight

    def sample_position(self, ref: Any, ds: Any, active: Bool | bool = True) -> tuple[PositionSample3f, Float]:
        """Sample a point that light leaves, with 1 / density; raise `SceneError` for light from infinity.

        The names of the arguments are Mitsuba's: `ref` is the time, `ds` the sample.
        """
        if self.shape is not None:
            ps = self.shape.sample_position(ref, Point2f(ds), active)
            return ps, dr.select(active & (ps.pdf > 0), dr.rcp(ps.pdf), 0)
        if not hasattr(self, "position"):
            raise SceneError(f"{self.id()}: light from infinity starts at no point")
        ps = PositionSample3f(p=Point3f(self.position), n=Normal3f(0, 0, 1), uv=Point2f(0.5), pdf=Float(1))
        ps.delta = Bool(True)
        return ps, Float(1)

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area; 0 for light from a point."""
        return Float(0) if self.shape is None else self.shape.pdf_position(ps, active)

    def sample_wavelengths(self, si: Interaction3f, sample: Any, active: Bool | bool = True) -> tuple[Any, Color3f]:
        """Sample wavelengths: none, since light is RGB, and the radiance at `si`."""
        return Wavelengths(), self.eval(si, active)
