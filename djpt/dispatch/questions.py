"""What only scripts ask of pointers to emitters, shapes and sensors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr

from djpt.dispatch.family import NONE, Pointer
from djpt.dispatch.lookup import choose
from djpt.dispatch.silhouettes import SilhouettePtrQuestions
from djpt.emitters.base import Emitter
from djpt.errors import SceneError
from djpt.records import (
    DirectionSample3f,
    EmissionSample,
    Observer,
    PositionSample3f,
    PreliminaryIntersection3f,
    Ray3f,
    RayFlags,
    SurfaceInteraction3f,
)
from djpt.records.record import Wavelengths
from djpt.sensors.base import Sensor
from djpt.shapes.base import Shape
from djpt.types import ArrayXf, Bool, Color3f, Float, Point2f, UInt32

__all__ = ["EmitterPtrQuestions", "SensorPtrQuestions", "ShapePtrQuestions"]


class EmitterPtrQuestions(Pointer[Emitter]):
    """The part of `djpt.EmitterPtr` that the renderer doesn't need."""

    member_kind = "emitter"

    def sample_emission(
        self, position_sample: Point2f, direction_sample: Point2f, active: Bool | bool = True
    ) -> EmissionSample:
        """See `djpt.EmitterPtr`."""
        raise NotImplementedError

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray that leaves the emitter, with Mitsuba's arguments: see `djpt.Emitter.sample_ray`."""
        es = self.sample_emission(Point2f(sample2), Point2f(sample3), active)
        es.ray.time = Float(time)
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
        """No wavelengths, since light is RGB, and the radiance at `si`."""
        value = self.ensemble.call(self.index, self.lookup, lambda e: e.eval(si, active), Color3f(0))
        return Wavelengths(), dr.select(active, value, 0)

    def get_medium(self) -> Any:
        """The media that the emitters stand in, a `djpt.dispatch.media.MediumPtr`."""
        from djpt.dispatch.media import MediumPtr  # scenes without media need none

        return self.related(MediumPtr, lambda emitter: emitter.get_medium())

    def sampling_weight(self) -> Float:
        """The emitters' `sampling_weight`; 0 where there is no emitter."""
        weights = [Float(emitter.sampling_weight()) for emitter in self.plugins]
        return dr.select(self.is_valid(), choose(self.index, weights), 0) if weights else Float(0)


class ShapePtrQuestions(SilhouettePtrQuestions):
    """The part of `djpt.ShapePtr` that the renderer doesn't need.

    Rays are intersected with each lane's shape alone. If the shapes of all lanes are one, the records belong to a scene
    of that shape; else to none, but they know their shape, and with it its BSDF and emitter.
    """

    member_kind = "shape"

    # ---- what it is ---------------------------------------------------------------------------

    def shape_type(self) -> UInt32:
        """The `djpt.ShapeType` per lane; 0 where there is no shape."""
        return dr.select(self.is_valid(), self.number(lambda shape: shape.shape_type()), 0)

    def is_ellipsoids(self) -> Bool:
        """True where the shape consists of ellipsoids."""
        return self.holds(lambda shape: shape.is_ellipsoids())

    def is_medium_transition(self) -> Bool:
        """True where the shape bounds a medium."""
        return self.holds(lambda shape: shape.is_medium_transition())

    def has_flipped_normals(self) -> Bool:
        """True where the shape has the key ``flip_normals``."""
        return self.holds(lambda shape: shape.has_flipped_normals())

    def interior_medium(self) -> Any:
        """The media inside the shapes, a `djpt.dispatch.media.MediumPtr`."""
        return self._media(lambda shape: shape.interior_medium())

    def exterior_medium(self) -> Any:
        """The media outside the shapes, a `djpt.dispatch.media.MediumPtr`."""
        return self._media(lambda shape: shape.exterior_medium())

    def _media(self, of: Callable[[Shape], Any]) -> Any:
        from djpt.dispatch.media import MediumPtr  # scenes without media need none

        return self.related(MediumPtr, of)

    # ---- attributes ---------------------------------------------------------------------------

    def has_attribute(self, name: str, active: Bool | bool = True) -> Bool:
        """True where the shape has values of that name."""
        return self.holds(lambda shape: shape.has_attribute(name)) & active

    def eval_attribute(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The values of that name as a colour, at points of the shapes; 0 where there are none.

        Raises:
            SceneError: none of the shapes has any.
        """
        return self._attribute(lambda shape, mine: shape.eval_attribute(name, si, mine), name, Color3f(0), active)

    eval_attribute_3 = eval_attribute

    def eval_attribute_1(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Float:
        """The values of that name, with one channel; else as `eval_attribute`."""
        return self._attribute(lambda shape, mine: shape.eval_attribute_1(name, si, mine), name, Float(0), active)

    def eval_attribute_x(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> ArrayXf:
        """The values of that name with all their channels, whose number must be the same for all shapes."""
        return self._attribute(lambda shape, mine: shape.eval_attribute_x(name, si, mine), name, None, active)

    def _attribute(self, method: Callable[[Shape, Bool], Any], name: str, nothing: Any, active: Bool | bool) -> Any:
        result = nothing
        owners = [i for i, shape in enumerate(self.plugins) if shape.has_attribute(name)]
        if not owners:
            raise SceneError(f"ShapePtr: none of the shapes has an attribute '{name}'")
        for i in set(owners).intersection(self.present()):
            mine = (self.index == i) & active
            value = method(self.plugins[i], mine)
            result = dr.select(mine, value, dr.zeros(type(value)) if result is None else result)
        return result

    # ---- rays -----------------------------------------------------------------------------------

    def ray_intersect(
        self, ray: Ray3f, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The first point of each lane's shape with 0 < t < maxt: see `djpt.Scene.ray_intersect`."""
        return self._asked(lambda shape, mine: shape.ray_intersect(ray, ray_flags, active & mine), SurfaceInteraction3f)

    def ray_intersect_preliminary(
        self, ray: Ray3f, prim_index: int = 0, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """The first hit of each lane's shape, of whatever primitive."""
        return self._asked(
            lambda shape, mine: shape.ray_intersect_preliminary(ray, prim_index, active & mine),
            PreliminaryIntersection3f,
        )

    def ray_test(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """True where the shape is hit with 0 < t < maxt."""
        return self.each(lambda shape, mine: shape.ray_test(ray, active & mine), Bool(False))

    def compute_surface_interaction(
        self, ray: Ray3f, pi: PreliminaryIntersection3f, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point of a hit: see `PreliminaryIntersection3f.compute_surface_interaction`."""
        if pi.home:
            return pi.compute_surface_interaction(ray, ray_flags, active)
        return self._asked(
            lambda shape, mine: shape.alone().surface_interaction_of(pi, ray, ray_flags, active & mine),
            SurfaceInteraction3f,
        )

    def eval_parameterization(
        self, uv: Any, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The points with the texture coordinates (u, v) in the unit square; `t` is 0.

        Raises:
            SceneError: one of the shapes has no parameterisation.
        """
        return self._asked(
            lambda shape, mine: shape.eval_parameterization(uv, ray_flags, active & mine), SurfaceInteraction3f
        )

    def _asked(self, method: Callable[[Shape, Bool], Any], kind: type[Any]) -> Any:
        """The records ``method(shape, mine)``, for lanes that may have different shapes."""
        present = self.present()
        if len(present) == 1:
            return method(self.plugins[present[0]], self.is_valid())
        result = dr.zeros(kind, dr.width(self.index))
        result.home = {}
        for i in present:
            mine = self.index == i
            result = dr.select(mine, loose(method(self.plugins[i], mine)), result)
        hit = dr.select(result.is_valid(), self.index, NONE)
        result.shape = type(self).holding(index=hit, home=self.home)
        return result


class SensorPtrQuestions(Pointer[Sensor]):
    """The methods of `djpt.SensorPtr`: each asks one sensor after the other; numbers are 0 where there is none."""

    member_kind = "sensor"

    def sample_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray of the sensor, and its weight: see `djpt.Sensor.sample_ray`."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_ray(time, sample1, sample2, sample3, active & mine), time),
            filled((dr.zeros(Ray3f), Color3f(0)), time),
        )

    def sample_ray_differential(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Any, Color3f]:
        """The same with the rays through the next pixels: see `djpt.Sensor.sample_ray_differential`."""

        def asked(sensor: Sensor, mine: Bool) -> Any:
            return filled(sensor.sample_ray_differential(time, sample1, sample2, sample3, active & mine), time)

        present = self.present()
        if not present:
            return self.sample_ray(time, sample1, sample2, sample3, active)
        first, weight = asked(self.plugins[present[0]], Bool(True))
        ray, weight = self.each(asked, (first, dr.select(self.is_valid(), weight, 0)))
        ray.has_differentials = True
        return ray, weight

    def sample_direction(self, it: Observer, sample: Any, active: Bool | bool = True) -> tuple[Any, Color3f]:
        """Sample the way from `it` to the sensor, with its importance: see `djpt.Sensor.sample_direction`."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_direction(it, sample, active & mine)),
            filled((DirectionSample3f(), Color3f(0))),
        )

    def pdf_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction`, per unit solid angle at `it`."""
        return self.each(lambda sensor, mine: sensor.pdf_direction(it, ds, active & mine), Float(0))

    def eval_direction(self, it: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """The importance that `sample_direction` returns for `ds`."""
        return self.each(lambda sensor, mine: sensor.eval_direction(it, ds, active & mine), Color3f(0))

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> tuple[PositionSample3f, Float]:
        """Sample a point of the sensor's surface, with 1 / density."""
        return self.each(
            lambda sensor, mine: filled(sensor.sample_position(time, sample, active & mine)),
            filled((dr.zeros(PositionSample3f), Float(0))),
        )

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area."""
        return self.each(lambda sensor, mine: sensor.pdf_position(ps, active & mine), Float(0))

    def eval(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The importance of light that arrives at `si`: see `djpt.Sensor.eval`."""
        return self.each(lambda sensor, mine: sensor.eval(si, active & mine), Color3f(0))

    def sample_wavelengths(
        self, si: SurfaceInteraction3f, sample: Any, active: Bool | bool = True
    ) -> tuple[Any, Color3f]:
        """No wavelengths, since light is RGB, with weight 1; 0 where there is no sensor."""
        return Wavelengths(), Color3f(dr.select(self.is_valid() & active, Float(1), 0))


def loose(record: Any) -> Any:
    """A record of a scene as one of none, with all its fields made, so that it can be selected with others."""
    for name in type(record).DRJIT_STRUCT:
        getattr(record, name)
    return record.replaced(home={}, **{name: () for name in ("media", "nearby") if hasattr(record, name)})


def filled(result: tuple[Any, Any], time: Any = None) -> tuple[Any, Any]:
    """A sample and its weight, whose fields of which some records have none are made the same for all."""
    sample, weight = result
    if isinstance(sample, Ray3f):
        return sample.replaced(times=(Float(time),), media=()), weight
    if isinstance(sample, DirectionSample3f):
        return sample.replaced(home={}), weight
    return sample, weight
