"""The shape of each lane: what `si.shape` is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.lookup import choose
from djpt.core.records import (
    DirectionSample3f,
    Observer,
    PositionSample3f,
    PreliminaryIntersection3f,
    Ray3f,
    RayFlags,
    SurfaceInteraction3f,
)
from djpt.dispatch.family import NONE, Pointer
from djpt.emitters.pointer import EmitterPtr
from djpt.errors import SceneError
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, Point2f, Point3f, UInt32
from djpt.materials.pointer import BSDFPtr
from djpt.sensors.pointer import SensorPtr
from djpt.shapes.base import Shape

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["ShapePtr"]


class ShapePtr(Pointer[Shape]):
    """The shape of each lane, or none. Methods as in `djpt.shapes.base.Shape`; numbers are 0 where there is none.

    Rays are intersected with each lane's shape alone. If the shapes of all lanes are one, the records belong to a scene
    of that shape; else to none, but they know their shape, and with it its BSDF and emitter.
    """

    member_kind = "shape"

    def bsdf(self) -> BSDFPtr:
        """The BSDFs of the shapes."""
        return self.related(BSDFPtr, lambda shape: shape.bsdf())

    def emitter(self) -> EmitterPtr:
        """The area lights of the shapes."""
        return self.related(EmitterPtr, lambda shape: shape.emitter())

    def sensor(self) -> SensorPtr:
        """The sensors of the shapes."""
        return self.related(SensorPtr, lambda shape: shape.sensor())

    def is_emitter(self) -> Bool:
        """True where the shape shines."""
        return self.holds(lambda shape: shape.is_emitter())

    def is_sensor(self) -> Bool:
        """True where the shape carries a sensor."""
        return self.holds(lambda shape: shape.is_sensor())

    def is_mesh(self) -> Bool:
        """True where the shape consists of triangles in memory."""
        return self.holds(lambda shape: shape.is_mesh())

    def surface_area(self) -> Float:
        """The area."""
        return self._ask(lambda shape: shape.surface_area(), Float(0))

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> PositionSample3f:
        """Sample a point uniformly by area; the pdf is 0 where there is no shape."""
        return self._sampled(lambda shape: shape.sample_position(time, Point2f(sample), active), active)

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area."""
        return self._ask(lambda shape: shape.pdf_position(ps, active), Float(0))

    def sample_direction(self, it: Observer, sample: Any, active: Bool | bool = True) -> DirectionSample3f:
        """Sample a point of the shape as seen from `it`; the pdf is 0 where there is no shape."""
        return self._sampled(lambda shape: shape.sample_direction(it, Point2f(sample), active), active)

    def pdf_direction(self, it: Observer, ps: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction`, per unit solid angle."""
        return self._ask(lambda shape: shape.pdf_direction(it, ps, active), Float(0))

    def _sampled(self, method: Callable[[Shape], Any], active: Bool | bool) -> Any:
        """The samples of the shapes, with the pdf 0 where there is none."""
        sample = self._ask(method, None)
        sample.pdf = dr.select(self.is_valid() & active, sample.pdf, 0)
        return sample

    def _ask(self, method: Callable[[Shape], Any], otherwise: Any) -> Any:
        return self.ensemble.call(self.index, self.lookup, method, otherwise)

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
        """The media inside the shapes, a `djpt.media.pointer.MediumPtr`."""
        return self._media(lambda shape: shape.interior_medium())

    def exterior_medium(self) -> Any:
        """The media outside the shapes, a `djpt.media.pointer.MediumPtr`."""
        return self._media(lambda shape: shape.exterior_medium())

    def _media(self, of: Callable[[Shape], Any]) -> Any:
        from djpt.media.pointer import MediumPtr  # scenes without media need none

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
        """The first hit of each lane's shape, on any of its primitives."""
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
        if pi.scene_ref:
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
        result.scene_ref = {}
        for i in present:
            mine = self.index == i
            result = dr.select(mine, loose(method(self.plugins[i], mine)), result)
        hit = dr.select(result.is_valid(), self.index, NONE)
        result.shape = type(self).holding(index=hit, scene_ref=self.scene_ref)
        return result

    # ---- silhouettes, and how shapes move --------------------------------------------------------

    def silhouette_discontinuity_types(self) -> UInt32:
        """The `DiscontinuityFlags` of the silhouettes per lane; 0 where there is no shape."""
        return dr.select(self.is_valid(), self.number(lambda shape: shape.silhouette_discontinuity_types()), 0)

    def silhouette_sampling_weight(self) -> Float:
        """The weights by which a scene chooses shapes to sample silhouettes of; 0 where there is no shape."""
        weights = [Float(shape.silhouette_sampling_weight()) for shape in self.plugins]
        return dr.select(self.is_valid(), choose(self.index, weights), 0) if weights else Float(0)

    def sample_silhouette(self, sample: Any, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette that belongs to a point of the unit cube: see `djpt.Shape.sample_silhouette`."""
        point = Point3f(sample)
        return self._silhouettes(lambda silhouette, mine: silhouette.sample(point, int(flags), mine & active))

    def invert_silhouette_sample(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample_silhouette` takes to a segment; 0 where there is no shape."""
        return self._ask_silhouettes(lambda silhouette, mine: silhouette.invert(ss, mine & active), Point3f(0))

    def primitive_silhouette_projection(
        self, viewpoint: Any, si: SurfaceInteraction3f, flags: int, sample: Any, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of the silhouette as seen from a point: see `djpt.Shape.primitive_silhouette_projection`."""
        seen_from, u = Point3f(viewpoint), Float(sample)
        return self._silhouettes(
            lambda silhouette, mine: silhouette.project(seen_from, si, int(flags), u, mine & active)
        )

    def sample_precomputed_silhouette(
        self, viewpoint: Any, sample1: Any, sample2: Any, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of a part of the silhouette: see `djpt.Shape.sample_precomputed_silhouette`."""
        seen_from, part, u = Point3f(viewpoint), UInt32(sample1), Float(sample2)
        return self._silhouettes(
            lambda silhouette, mine: silhouette.sample_precomputed(seen_from, part, u, mine & active)
        )

    def differential_motion(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Point3f:
        """The point `si.p`, attached to the parameters of the shapes: see `djpt.Shape.differential_motion`."""
        p = Point3f(si.p)
        for number, shape in enumerate(self.plugins):
            if shape.parameters_grad_enabled():
                mine = self.index == number
                p = dr.select(mine, shape.differential_motion(si, mine & active), p)
        return p

    def _silhouettes(self, question: Callable[[Any, Bool], SilhouetteSample3f]) -> SilhouetteSample3f:
        from djpt.shapes.silhouettes.lanes import numbered
        from djpt.shapes.silhouettes.samples import SilhouetteSample3f

        found: SilhouetteSample3f = self._ask_silhouettes(question, SilhouetteSample3f())
        return numbered(found, self.plugins, self.index)

    def _ask_silhouettes(self, question: Callable[[Any, Bool], Any], otherwise: Any) -> Any:
        from djpt.shapes.silhouettes.lanes import ask  # rendering needs no silhouettes

        return ask(self.ensemble, self.index, self.lookup, question, otherwise)


def loose(record: Any) -> Any:
    """A record of a scene as one of none, with all its fields made, so that it can be selected with others."""
    for name in type(record).DRJIT_STRUCT:
        getattr(record, name)
    return record.replaced(scene_ref={}, **{name: () for name in ("media", "nearby") if hasattr(record, name)})
