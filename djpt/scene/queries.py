"""The parts of a scene, the queries of them that integrators make, and the test for points inside of shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr

from djpt.core.lookup import Members
from djpt.core.records import RAY_EPSILON, DirectionSample3f, PreliminaryIntersection3f, Ray3f, SurfaceInteraction3f
from djpt.core.records.flags import SurfaceDetail
from djpt.core.records.record import of_scene
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.emitters.pointer import EmitterPtr
from djpt.geometry.aggregate import Geometry
from djpt.geometry.query import Hit
from djpt.jit.kernels import while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.materials.pointer import BSDFPtr
from djpt.scene.lights import BSDFs, Lights
from djpt.scene.media_placement import Media
from djpt.textures.base import detail_read

__all__ = ["SceneQueries", "closed_shapes", "is_inside"]

DIRECTION = (0.3651484, 0.5477226, 0.7527727)
"""The direction of the rays, arbitrary but not along an axis, where rays would run within the faces of boxes."""


@dataclass
class Walk:
    """A ray on its way out of the scene, and the crossings so far: loop state."""

    o: Point3f
    crossings: UInt32
    active: Bool


def closed_shapes(geometry: Geometry) -> list[int]:
    """The indices of shapes that have an inside: meshes whose edges all pair up, and the closed analytic ones."""
    return [i for i, shape in enumerate(geometry.contents.shapes) if shape.is_closed()]


def is_inside(geometry: Geometry, p: Point3f, active: Bool | bool = True) -> Bool:
    """Whether a point lies within an odd number of closed surfaces.

    A ray from an inner point crosses a closed surface an odd number of times (the Jordan-Brouwer theorem);
    crossings of open shapes don't count. After each crossing the ray starts again RAY_EPSILON (1 + max abs(p))
    further on, so thinner walls may be missed.
    """
    inner = closed_shapes(geometry)
    count = len(geometry.contents.shapes)
    if not inner:
        return Bool(active) & Bool(False)
    closed, direction = Members(inner, count), Vector3f(*DIRECTION)

    def step(walk: Walk) -> tuple[Walk]:
        ray = Ray3f(walk.o, direction)
        hit = geometry.closest(ray)
        found = hit.is_valid() & walk.active
        crossings = walk.crossings + dr.select(found & closed.contain(hit.shape_index), UInt32(1), 0)
        there = ray(dr.select(found, hit.t, 0))
        on = dr.fma(direction, RAY_EPSILON * (1 + dr.max(dr.abs(there))), there)
        return (Walk(on, crossings, found),)

    start = wide(Walk(Point3f(p), UInt32(0), Bool(active)), dr.width(p, active))
    (end,) = while_loop((start,), lambda walk: walk.active, step, label="inside")
    return (end.crossings & 1) == 1


class SceneQueries(Plugin):
    """A scene as integrators see it: its parts, and what takes several of them to answer.

    Queries take per-lane rays and points. Values of plugins are read through `lookup`; a view of the scene
    (`Scene.replace`) reads them in another way.
    """

    kind: ClassVar[str] = "scene"
    units: Any = None
    """Of a scene in a working frame: what lengths and points are in its description
    (`djpt.scene.normalization.normalized_scene`)."""
    is_view = False
    """Whether it is a view of a scene, which rendering has made."""

    lookup: Lookup
    """The way to read the plugins' values."""
    geometry: Geometry
    """The shapes, as ray queries see them."""
    bsdfs: BSDFs
    """The BSDFs of shapes."""
    lights: Lights
    """The emitters, and the way to choose among them."""
    media: Media
    """The media that are followed along rays: those that absorb without scattering or, in some views, all."""
    every_medium: Media
    """All media."""
    moves: bool
    in_time: bool
    camera_medium: UInt32 | None
    """The number of the medium that camera rays start in; None if no media are followed. Of a sensor with `delegates`
    there may be a number for each of these: see `medium_of_camera`."""
    outer_medium: UInt32 | None = None
    """The number of the medium outside of all bodies, if a sensor has one."""
    has_image_circle = False
    """Whether some camera rays end where they begin, and see nothing: see `Sensor.has_image_circle`."""
    near_clip_fraction: Float
    """The fraction of a camera ray's `maxt` between the camera and its near plane: see `Sensor.near_clip_fraction`."""

    def ensembles(self) -> Sequence[Ensemble[Any]]:
        """The plugins whose values a path vertex looks up: BSDFs, emitters, and media if there are any."""
        return self.bsdfs.ensemble, self.lights.ensemble, *self.media.ensembles

    @property
    def surface_detail(self) -> SurfaceDetail:
        """The parts of a surface point that BSDFs, emitters and media look at."""
        every = (detail_read(plugin) for ensemble in self.ensembles() for plugin in ensemble.plugins)
        return max(every, default=SurfaceDetail.FRAME)

    # ---- surfaces ------------------------------------------------------------------------

    def closest_hit(
        self, ray: Ray3f, active: Bool | bool = True, *, through_lights: Bool | None = None
    ) -> PreliminaryIntersection3f:
        """The face that a ray hits first, and the distance: all that integrators need to go on.

        Lanes with `through_lights` ignore shapes that emit.
        """
        pi = self.geometry.closest(ray, through_lights)
        if active is not True:
            pi.t = dr.select(active, pi.t, dr.inf)
        return pi

    def is_inside(self, p: Point3f, active: Bool | bool = True) -> Bool:
        """True where a point is within an odd number of closed surfaces; open shapes don't count."""
        return is_inside(self.geometry, p, active)

    def surface_interaction(
        self, ray: Ray3f, pi: PreliminaryIntersection3f, detail: SurfaceDetail = SurfaceDetail.PARTIALS
    ) -> SurfaceInteraction3f:
        """The surface point of a preliminary intersection; beyond `detail` its parts are unspecified."""
        valid = pi.is_valid()
        back = dr.select(ray.maxt > 0, -ray.d, 0) if self.has_image_circle else -ray.d
        surface = self.geometry.surface(ray, pi, self.lookup, detail)
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(
            p=surface.p,
            n=surface.n,
            sh_frame=surface.sh_frame,
            uv=surface.uv,
            dp_du=surface.dp_du,
            dp_dv=surface.dp_dv,
            wi=dr.select(valid, surface.sh_frame.to_local(-ray.d), back),
            shape_index=dr.select(valid, pi.shape_index, 0),
            face=pi.face,
            media=pi.media or ray.media,
            prim_uv=surface.prim_uv,
            scene_ref=of_scene(self),
        )
        si.found_at(pi.t, valid)
        si.arrived_with(ray)
        return si

    def revisit(
        self, p: Point3f, d: Vector3f, face: UInt32, detail: SurfaceDetail = SurfaceDetail.PARTIALS
    ) -> SurfaceInteraction3f:
        """The surface interaction at a stored point `p` of a face, as for a ray of direction `d`.

        A face that belongs to an instance can't be revisited: its number doesn't say which instance.
        """
        hit = PreliminaryIntersection3f.found(Float(0), face, self.geometry.shape_of(face))
        return self.surface_interaction(Ray3f(p, d), hit, detail=detail)

    def primitive_index(self, si: SurfaceInteraction3f) -> UInt32:
        """The primitive of its shape that `si` lies on, numbered as in Mitsuba: triangles of meshes and boxes."""
        return self.geometry.primitive_index(si.face, si.uv, si.p, self.lookup)

    # ---- plugins at surface points ---------------------------------------------------------

    def bsdf_at(self, si: SurfaceInteraction3f) -> BSDFPtr:
        """The BSDF of the shape at `si`, with the relative index that follows from what surrounds the shape there."""
        bsdf = self.bsdfs.at(si.face)
        around = self.media.index_around(si)
        return bsdf if around is None else bsdf.replaced(around=(around,))

    def emitter_index_at(self, si: SurfaceInteraction3f) -> UInt32:
        """The number of the emitter seen at `si`; the count of emitters means none."""
        index = self.lights.index_at(si.face, si.is_valid())
        return dr.select(self._sees(si), index, UInt32(len(self.lights.ensemble))) if self.has_image_circle else index

    def covered_by_sky(self, si: SurfaceInteraction3f) -> Bool | bool:
        """Whether the environment, if there is one, is what a ray meets that hits nothing."""
        return self.lights.environment is not None and (not self.has_image_circle or self._sees(si))

    def _sees(self, si: SurfaceInteraction3f) -> Bool:
        """False for rays that end where they begin: they come from nowhere."""
        return si.is_valid() | (dr.squared_norm(si.wi) > 0)

    def emitter_at(self, si: SurfaceInteraction3f) -> EmitterPtr:
        """The emitter seen at `si`: that of the shape, or the environment on a miss."""
        return self.lights.at(self.emitter_index_at(si))

    def emitter_ptr(self, index: UInt32) -> EmitterPtr:
        """The emitters with the numbers `index`, per lane."""
        return self.lights.at(index)

    def medium_beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32 | None:
        """The medium of a ray that leaves `si` in the world direction `d`."""
        return self.media.beyond(si, d) if self.media else si.medium

    def medium_of_camera(self, sensor: Any, pixel: UInt32, film_position: Point2f) -> UInt32 | None:
        """The medium that rays of a sensor start in, of pixels and places on the crop window."""
        medium = self.camera_medium
        if medium is None or dr.width(medium) == 1:
            return medium
        number = sensor.looks_through(pixel, film_position)
        return dr.gather(UInt32, medium, number)

    def medium_at(self, p: Point3f) -> UInt32 | None:
        """The medium that each point lies in, for rays that begin there; None in scenes without media."""
        return self.media.at(p, outside=self.outer_medium) if self.media else None

    # ---- what arrives of light ---------------------------------------------------------------

    def shadow_ray(self, si: SurfaceInteraction3f, ds: DirectionSample3f) -> Ray3f:
        """The ray from `si` to the emitter sample `ds`."""
        infinite = self.lights.from_infinity(ds.emitter_index)
        if infinite is None:
            return si.spawn_ray_to(ds.p)
        to_point, to_sky = si.spawn_ray_to(ds.p), si.spawn_ray(ds.d)
        return dr.select(infinite, to_sky, to_point)

    def transmittance(
        self,
        ray: Ray3f,
        weight: Color3f | None = None,
        lit: Bool | None = None,
        *,
        to_emitter: bool = True,
        through_lights: Bool | bool = False,
    ) -> Color3f:
        """The transmittance V exp(-tau) of the segment of a ray, times `weight`: what arrives of light.

        V is 0 if a surface lies between the ends, else 1; tau is the optical thickness of the ray's medium. Null
        surfaces hide like all others, and media must have a closed form: see
        `djpt.integrators.paths.transmittance` for what lies behind and in the others.

        Args:
            ray: A segment such as `shadow_ray` gives.
            weight: The light that sets out, default 1. Surfaces are looked for only where it isn't black.
            lit: Lanes whose surfaces are looked for anyway: black light may have derivatives.
            to_emitter: Whether the segment ends at a sampled point of an emitter. Then shapes are left out that
                can't lie between, such as the walls around everything; from another surface or a camera these may
                hide what is behind them.
            through_lights: Lanes in which shapes that emit hide nothing; only for segments that aren't `to_emitter`.
        """
        left = self.media.transmittance(ray)
        if weight is not None:
            left = weight * left
        shines = dr.max(left) > 0
        followed = shines if lit is None else shines | lit
        if to_emitter:
            hidden = self.geometry.blocked(ray, followed)
        elif through_lights is False:
            hidden = self.geometry.any_hit(ray, followed)
        else:
            hidden = self.closest_hit(ray, through_lights=Bool(through_lights)).is_valid()
        return dr.select(hidden, 0, left)

    def next_hit(
        self, ray: Ray3f, to_light: Ray3f, weight: Color3f, through_lights: Bool | None
    ) -> tuple[Hit, Color3f]:
        """The hit that `closest_hit` finds for `ray`, and `transmittance` along `to_light`, by one search for both.

        The geometry must be one that `searches_pairs`.
        """
        left = weight * self.media.transmittance(to_light)
        hit, hidden = self.geometry.closest_and_blocked(ray, to_light, dr.max(left) > 0, through_lights)
        return hit, dr.select(hidden, 0, left)
