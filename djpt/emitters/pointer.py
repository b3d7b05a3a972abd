"""The emitter of each lane: what `si.emitter(scene)` returns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.lookup import choose
from djpt.core.records import (
    DirectionSample3f,
    EmissionSample,
    Observer,
    PositionSample3f,
    Ray3f,
    Reference,
    SurfaceInteraction3f,
)
from djpt.core.records.record import Wavelengths
from djpt.dispatch.family import Pointer, filled
from djpt.emitters.base import Emitter
from djpt.emitters.moving import Carriers, carriers_of, time_of
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.shapes.pointer import ShapePtr

__all__ = ["EmitterPtr", "observer"]


class EmitterPtr(Pointer[Emitter]):
    """The emitter of each lane, or none. Methods as in `djpt.emitters.base.Emitter`."""

    member_kind = "emitter"

    def flags(self) -> UInt32:
        """The `EmitterFlags` per lane; 0 where there is no emitter."""
        if not self.plugins:
            return UInt32(0)
        return dr.select(self.is_valid(), self.number(lambda emitter: emitter.flags()), 0)

    def is_environment(self) -> Bool:
        """True where the emitter surrounds the scene."""
        return self.holds(lambda emitter: emitter.is_environment())

    def get_shape(self) -> ShapePtr:
        """The shapes that the emitters stand in; none for those that stand alone."""
        from djpt.shapes.pointer import ShapePtr  # which knows the emitters of shapes

        return self.related(ShapePtr, lambda emitter: emitter.get_shape())

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The emitted radiance; 0 where there is no emitter and on inactive lanes."""
        if self.carriers is not None:
            si = self.carriers.at(self.index, si.time).own_hit(si)
        value = self.ensemble.call(self.index, self.lookup, lambda e: e.eval(si, active), Color3f(0))
        return dr.select(active, value, 0)

    @property
    def carriers(self) -> Carriers | None:
        """What moves the emitters that lanes choose among; None if all stay."""
        return carriers_of(self.plugins)

    def sample_direction(
        self, it: Observer | Point3f, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """A direction towards the emitter; weight 0 where there is none."""
        at = observer(it)
        carried = None if self.carriers is None else self.carriers.at(self.index, time_of(at))
        at = at if carried is None else carried.own_observer(at)
        ds, weight = self.ensemble.call(self.index, self.lookup, lambda e: e.sample_direction(at, sample, active), None)
        ds = ds if carried is None else carried.sample(ds)
        ds.emitter_index = self.index
        return ds, dr.select(self.is_valid() & active, weight, 0)

    def pdf_direction(self, it: Observer | Point3f, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction`, per unit solid angle; 0 where there is no emitter."""
        at = observer(it)
        if self.carriers is not None:
            carried = self.carriers.at(self.index, time_of(at, ds))
            at, ds = carried.own_observer(at), carried.own_sample(ds)
        pdf = self.ensemble.call(self.index, self.lookup, lambda e: e.pdf_direction(at, ds, active), Float(0))
        return dr.select(active, pdf, 0)

    def eval_and_pdf(
        self, si: SurfaceInteraction3f, it: Observer, ds: DirectionSample3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """The emitted radiance, and the density of `sample_direction` in the direction from which it was met."""
        if self.carriers is not None:
            carried = self.carriers.at(self.index, si.time)
            si, it, ds = carried.own_hit(si), carried.own_observer(it), carried.own_sample(ds)
        value, pdf = self.ensemble.call(
            self.index, self.lookup, lambda e: e.eval_and_pdf(si, it, ds, active), (Color3f(0), Float(0))
        )
        return dr.select(active, value, 0), dr.select(active, pdf, 0)

    def eval_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """The weight of `sample_direction` times its density, at `ds`; 0 where there is no emitter."""
        if self.carriers is not None:
            carried = self.carriers.at(self.index, time_of(it, ds))
            it, ds = carried.own_observer(it), carried.own_sample(ds)
        value = self.ensemble.call(self.index, self.lookup, lambda e: e.eval_direction(it, ds, active), Color3f(0))
        return dr.select(active, value, 0)

    def sample_emission(
        self,
        position_sample: Point2f,
        direction_sample: Point2f,
        active: Bool | bool = True,
        time: Float | None = None,
    ) -> EmissionSample:
        """Sample a ray that leaves the emitter at a time; weight 0 where there is none and on inactive lanes."""
        es = self.ensemble.call(
            self.index, self.lookup, lambda e: e.sample_emission(position_sample, direction_sample, active), None
        )
        if self.carriers is not None:
            at = Float(0) if time is None else time
            es = self.carriers.at(self.index, at).emission(es, at)
        elif time is not None:
            es.ray.time = time
        es.weight = dr.select(self.is_valid() & active, es.weight, 0)
        return es

    def pdf_emission(
        self, d: Vector3f, n: Normal3f, uv: Point2f, active: Bool | bool = True, time: Float | None = None
    ) -> tuple[Float, Float]:
        """The densities of `sample_emission` by position and direction; 0 where there is no emitter."""
        area: Float | None = None
        if self.carriers is not None:
            carried = self.carriers.at(self.index, Float(0) if time is None else time)
            d, n, area = carried.own_direction(d), Normal3f(carried.own_direction(n)), carried.area
        position, direction = self.ensemble.call(
            self.index, self.lookup, lambda e: e.pdf_emission(d, n, uv, active), (Float(0), Float(0))
        )
        return dr.select(active, position if area is None else position / area, 0), dr.select(active, direction, 0)

    # ---- what only scripts ask ------------------------------------------------------------------

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray that leaves the emitter, with Mitsuba's arguments: see `djpt.Emitter.sample_ray`."""
        es = self.sample_emission(Point2f(sample2), Point2f(sample3), active, Float(time))
        return es.ray, es.weight

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> tuple[PositionSample3f, Float]:
        """Sample a point that light leaves, with 1 / density; the pdf is 0 where there is no emitter.

        Raises:
            SceneError: one of the emitters is light from infinity.
        """
        return self.each(
            lambda emitter, mine: filled(emitter.sample_position(time, sample, active & mine)),
            filled((dr.zeros(PositionSample3f), Float(0))),
        )

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area; 0 where there is no emitter and for light from a point."""
        return self.each(lambda emitter, mine: emitter.pdf_position(ps, active & mine), Float(0))

    def sample_wavelengths(
        self, si: SurfaceInteraction3f, sample: Any, active: Bool | bool = True
    ) -> tuple[Any, Color3f]:
        """Sample wavelengths: none, since light is RGB, and the radiance at `si`."""
        value = self.ensemble.call(self.index, self.lookup, lambda e: e.eval(si, active), Color3f(0))
        return Wavelengths(), dr.select(active, value, 0)

    def get_medium(self) -> Any:
        """The media that the emitters stand in, a `djpt.media.pointer.MediumPtr`."""
        from djpt.media.pointer import MediumPtr  # scenes without media need none

        return self.related(MediumPtr, lambda emitter: emitter.get_medium())

    def sampling_weight(self) -> Float:
        """The emitters' `sampling_weight`; 0 where there is no emitter."""
        weights = [Float(emitter.sampling_weight()) for emitter in self.plugins]
        return dr.select(self.is_valid(), choose(self.index, weights), 0) if weights else Float(0)


def observer(it: Observer | Point3f) -> Observer:
    """A point that light is sampled for, from a record or a mere point."""
    return Reference(it, None) if isinstance(it, Point3f) else it
