"""The scene: plugins compiled into what kernels read, and the queries that integrators make."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, ClassVar, Protocol

import drjit as dr
import numpy as np

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.lookup import Members
from djpt.core.records import (
    BSDFFlags,
    DirectionSample3f,
    EmitterFlags,
    PreliminaryIntersection3f,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.core.records.scene_ref import note_latest
from djpt.description.merging import Merging
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.dispatch.ensemble import Detached, Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.emitters import Emitter
from djpt.emitters.pointer import EmitterPtr
from djpt.errors import RenderError, SceneError
from djpt.geometry.aggregate import Geometry
from djpt.geometry.parity import is_inside
from djpt.jit.frozen import recording, require_editable
from djpt.jit.kernels import may_wait
from djpt.jit.types import Bool, Float, Point3f, TensorXf, UInt32, Vector3f
from djpt.materials import BSDF
from djpt.materials.pointer import BSDFPtr
from djpt.scene.light_queries import LightQuestions
from djpt.scene.mitsuba_api import RayQuestions
from djpt.scene.nesting import black, collect_emitters, collect_sensors, numbers
from djpt.scene.silhouettes import SceneSilhouettes
from djpt.scene.visibility import VisibilityQueries
from djpt.sensors import Sensor
from djpt.sensors.pointer import SensorPtr
from djpt.shapes import Shape
from djpt.shapes.numbering import merged_last
from djpt.shapes.pointer import ShapePtr
from djpt.textures.uses import check_textures, reads_uv

__all__ = ["Renderer", "Scene"]


WITHOUT_EFFECT = ("allow_thread_reordering", "compact_acceleration_structures", "embree_use_robust_intersections")
"""Mitsuba's settings for ray queries of its own, which descriptions may hold."""


class Renderer(Protocol):
    """What renders a scene: `djpt.rendering`, which is built on scenes and gives itself to each that it makes."""

    def prepare_to_record(self, scene: Scene) -> None:
        """Make what can't be made while a frozen function is recorded that renders the scene."""

    def film_image(self, scene: Scene, sensor: Any, integrator: Any, seed: Any, spp: int) -> TensorXf:
        """The image (H, W, C) of an integrator, whose derivatives use the samples of the image."""

    def image_derivative(
        self, scene: Scene, integrator: Any, sensor: Any, seed: Any, spp: int, grad: TensorXf | None
    ) -> TensorXf:
        """The derivative of an image: see `djpt.rendering.image.image_derivative`."""


class Scene(RayQuestions, VisibilityQueries, LightQuestions, SceneSilhouettes, Plugin):
    """Shapes, emitters, sensors and an integrator, ready to render.

    Lights and sensors are numbered in the order of the description, except that those of rectangles, cubes and other
    meshes without attributes come last unless `djpt.load_dict` was told not to optimise: see `djpt.shapes.numbering`.

    The queries take per-lane rays and points. A scene reads its plugins' values through a
    `Lookup`; `with_lookup` gives a view of the same scene that reads them in another way.
    """

    kind: ClassVar[str] = "scene"
    units: Any = None
    """Of a scene in a working frame: what lengths and points are in its description
    (`djpt.scene.normalization.units`)."""

    def __init__(self, props: Properties, renderer: Renderer | None = None) -> None:
        super().__init__(props)
        self._renderer = renderer
        for setting in WITHOUT_EFFECT:
            props.boolean(setting, False)
        self.named = [(key, plugin) for kind in KINDS for key, plugin in props.children(kind)]
        order = {key: i for i, key in enumerate(props.keys())}
        self.named.sort(key=lambda entry: order[entry[0]])

        self._shapes: list[Shape] = self._of_kind("shape")
        integrators = self._of_kind("integrator")
        if len(integrators) > 1:
            raise SceneError(f"{props.node}: found {len(integrators)} integrators; a scene has one")
        self._integrator = integrators[0] if integrators else None
        plugins = self._numbered(props.merging)
        self._sensors = collect_sensors(plugins)
        self._emitters = collect_emitters(plugins)
        infinite = [i for i, e in enumerate(self._emitters) if e.is_environment()]
        if len(infinite) > 1:
            raise SceneError(f"{props.node}: only one environment emitter is possible, found {len(infinite)}")
        self._environment = infinite[0] if infinite else None
        self.in_time = any(emitter.in_time for emitter in self._emitters)
        """Whether rays need a time, because some light depends on it."""
        with may_wait():
            self._compile()

    def _numbered(self, merging: Merging | None) -> list[Plugin]:
        """The plugins in the order in which Mitsuba numbers them: those that its loader merges with others are last."""
        if merging is None:
            return [plugin for _, plugin in self.named]
        existed = [plugin for key, plugin in self.named if key not in merging.keys]
        return existed + merged_last((plugin for key, plugin in self.named if key in merging.keys), merging.alike)

    @property
    def renderer(self) -> Renderer:
        """What renders the scene.

        Raises:
            RenderError: The scene wasn't made by `load_dict`.
        """
        if self._renderer is None:
            raise RenderError("a scene is rendered if load_dict made it; this one was made without")
        return self._renderer

    def _of_kind(self, kind: str) -> list[Any]:
        return [plugin for _, plugin in self.named if plugin.kind == kind]

    def _compile(self) -> None:
        self.lookup: Lookup = Detached()
        self.twin: Any = ()
        """The scene that is rendered in the place of this one, see `djpt.scene.normalization.normalized_scene`; ():
        not known yet."""
        self._from_infinity = [i for i, e in enumerate(self._emitters) if e.from_infinity]
        self.geometry = Geometry(self._shapes, self._light_positions(), bool(self._from_infinity))

        contents, none = self.geometry.contents, len(self._emitters)
        bsdfs, self.bsdf_of_shape, self._light_of_shape = numbers(contents.shapes, self._emitters)
        self.lights: Ensemble[Emitter] = Ensemble(self._emitters)
        self._at_infinity = Members(self._from_infinity, none)
        # A scene without surfaces still traces the code of a vertex: that needs a BSDF to ask.
        self._use_bsdfs(bsdfs or [black(f"{self.id()}.bsdf")])
        check_textures(contents.shapes)
        self._set_bounds()
        self._prepare()
        self.begin_choices()
        self._light_on_miss = none if self._environment is None else self._environment
        self.camera_medium = UInt32(self.media.vacuum) if self.media else None
        self.near_share = Float(0)
        self._families: dict[Any, Family[Any]] = {}
        for shape in self._shapes:
            shape.used_in(self)
        note_latest(self)

    def renew_bsdfs(self) -> None:
        """Follow a change of a shape's BSDF."""
        bsdfs, self.bsdf_of_shape, self._light_of_shape = numbers(self.geometry.contents.shapes, self._emitters)
        self._use_bsdfs(bsdfs)
        self._families.clear()
        self._prepare()
        self.twin = ()

    def _use_bsdfs(self, bsdfs: Sequence[BSDF]) -> None:
        self.bsdfs: Ensemble[BSDF] = Ensemble(bsdfs)
        self.find_media()

    def ensembles(self) -> Sequence[Ensemble[Any]]:
        """The plugins whose values a path vertex looks up: BSDFs, emitters, and media if there are any."""
        return self.bsdfs, self.lights, *self.media.ensembles

    def _light_positions(self) -> list[Point3f]:
        return [e.position for e in self._emitters if has_flag(e.flags(), EmitterFlags.DeltaPosition)]  # type: ignore[attr-defined]

    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """A sphere around the bounding box of all shapes, slightly enlarged: centre (3,) and radius."""
        return self.geometry.bounding_sphere()

    def _set_bounds(self) -> None:
        """Tell sensors and emitters how large the scene is."""
        center, radius = self.bounding_sphere()
        for emitter in self._emitters:
            emitter.set_bounds(center, radius)
        for sensor in self._sensors:
            sensor.set_bounds(center, radius)

    def _prepare(self) -> None:
        """Build all tables, after the scene was compiled or edited."""
        assert isinstance(self.lookup, Detached)
        shapes = self.geometry.contents.shapes
        self._differentiated = [(i, shape) for i, shape in enumerate(shapes) if shape.parameters_grad_enabled()]
        self._bsdf_of_face = self.geometry.per_face(self.bsdf_of_shape)
        self._light_of_face = self.geometry.per_face(self._light_of_shape)
        self.prepare_media()
        for ensemble in (self.geometry.surfaces, *self.ensembles(), *self.every_medium.ensembles):
            self.lookup.prepare(ensemble.leaves())

    # ---- parameters -----------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        for name, plugin in self.named:
            callback.put(name, plugin)

    def refresh(self, changed: Sequence[Plugin]) -> None:
        """Renew what was derived from the parameters of the `changed` plugins."""
        assert isinstance(self.lookup, Detached)
        require_editable(changed)
        self.lookup.forget()
        self._families.clear()
        for shape in self._shapes:
            shape.forget_alone()
        # A lobe that an edit turns on is new code.
        if not all(ensemble.is_current() for ensemble in (self.bsdfs, *self.every_medium.ensembles)):
            self._use_bsdfs(self.bsdfs.plugins)
        if not self.lights.is_current():
            self.lights = Ensemble(self._emitters)
        shapes = [plugin for plugin in changed if isinstance(plugin, Shape)]
        if shapes:
            self.geometry.move(shapes)
        if any(isinstance(plugin, Emitter) for plugin in changed):
            self.geometry.move_points(self._light_positions())
        if shapes:
            self._set_bounds()
        if shapes or any(plugin.kind in ("emitter", "texture", "volume") for plugin in changed):
            self.forget_choices()
        self._prepare()
        self._refresh_twin(changed)

    def _refresh_twin(self, changed: Sequence[Plugin]) -> None:
        """Let the twin follow an edit; it shares most materials and textures, and has copies of all else."""
        if self.twin and all(plugin.kind in ("bsdf", "texture") and self.twin[0].shares(plugin) for plugin in changed):
            self.twin[1].refresh(changed)
        elif self.twin or any(isinstance(plugin, Shape) for plugin in changed):
            self.twin = ()

    def prepare_to_record(self) -> None:
        if not recording():
            self.renderer.prepare_to_record(self)

    def _view(self) -> Scene:
        """A shallow copy, to be changed in what makes it a view."""
        view = copy.copy(self)
        view._families, view.is_view = {}, True
        note_latest(view)
        return view

    def with_lookup(self, lookup: Lookup) -> Scene:
        """A view of this scene that reads values through `lookup`."""
        view = self._view()
        view.lookup = lookup
        return view

    def with_geometry(self, geometry: Geometry) -> Scene:
        """A view of this scene whose rays meet `geometry`, which must number faces and shapes in the same way."""
        view = self._view()
        view.geometry = geometry
        return view

    def measured_from(self, sensor: Sensor) -> Scene:
        """A view of this scene that knows how far from a sensor its rays start: see `Sensor.near_share`."""
        view = self._view()
        view.near_share = dr.opaque(Float, sensor.near_share())
        return view

    def seen_by(self, sensor: Sensor) -> Scene:
        """A view of this scene for the rays of a sensor: it knows where they start, and in which medium."""
        view = self._view()
        view.geometry = self.geometry.seen_from(sensor.starts())
        if self.media:
            view.begin_in_media_of(sensor)
        return view

    # ---- contents ----------------------------------------------------------------------

    def sensors(self) -> list[Sensor]:
        """All sensors, in the order of the description."""
        return list(self._sensors)

    def emitters(self) -> list[Emitter]:
        """All emitters in the order in which light sampling numbers them."""
        return list(self._emitters)

    def shapes(self) -> list[Shape]:
        """All shapes, in the order of the description."""
        return list(self._shapes)

    def integrator(self) -> Any:
        """The integrator, or None."""
        return self._integrator

    def environment(self) -> Emitter | None:
        """The emitter that surrounds the scene, or None."""
        return None if self._environment is None else self._emitters[self._environment]

    def shapes_dr(self) -> ShapePtr:
        """All shapes, one per lane."""
        return ShapePtr.into(Family(Ensemble(self._shapes), self.lookup), dr.arange(UInt32, len(self._shapes)))

    def emitters_dr(self) -> EmitterPtr:
        """All emitters, one per lane."""
        return self.emitter_ptr(dr.arange(UInt32, len(self._emitters)))

    def sensors_dr(self) -> SensorPtr:
        """All sensors, one per lane."""
        return SensorPtr.into(Family(Ensemble(self._sensors), self.lookup), dr.arange(UInt32, len(self._sensors)))

    def shape_types(self) -> int:
        """The kinds of all shapes, values of `ShapeType`, combined."""
        kinds = 0
        for shape in self._shapes:
            kinds |= int(shape.shape_type())
        return kinds

    def bbox(self) -> ScalarBoundingBox3f:
        """The box about all shapes, world space; ``low, high = scene.bbox()`` gives its corners."""
        return ScalarBoundingBox3f(*self.geometry.bounding_box())

    @property
    def refracts(self) -> bool:
        """True if a path can cross an interface between different indices of refraction."""
        return any(has_flag(bsdf.flags(), TRANSMITS) for bsdf in self.bsdfs.plugins)

    @property
    def has_null(self) -> bool:
        """True if a path can pass straight through a surface, as if it weren't there."""
        return any(has_flag(bsdf.flags(), BSDFFlags.Null) for bsdf in self.bsdfs.plugins)

    @property
    def needs_uv(self) -> bool:
        """True if a BSDF or an emitter looks at uv or its derivatives."""
        return any(reads_uv(plugin) for ensemble in self.ensembles() for plugin in ensemble.plugins)

    # ---- ray queries ---------------------------------------------------------------------

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

    def shadow_ray(self, si: SurfaceInteraction3f, ds: DirectionSample3f) -> Ray3f:
        """The ray from `si` to the emitter sample `ds`."""
        if not self._from_infinity:
            return si.spawn_ray_to(ds.p)
        to_point, to_sky = si.spawn_ray_to(ds.p), si.spawn_ray(ds.d)
        return dr.select(self._at_infinity.contain(ds.emitter_index), to_sky, to_point)

    def surface_interaction(self, ray: Ray3f, pi: PreliminaryIntersection3f, full: bool = True) -> SurfaceInteraction3f:
        """The surface point of a preliminary intersection; uv and dp/du, dp/dv only if `full`."""
        valid = pi.is_valid()
        surface = self.geometry.surface(ray, pi, self.lookup, full)
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(
            p=surface.p,
            n=surface.n,
            sh_frame=surface.sh_frame,
            uv=surface.uv,
            dp_du=surface.dp_du,
            dp_dv=surface.dp_dv,
            wi=dr.select(valid, surface.sh_frame.to_local(-ray.d), -ray.d),
            shape_index=dr.select(valid, pi.shape_index, 0),
            face=pi.face,
            media=ray.media,
            prim_uv=surface.prim_uv,
            home={self: ()},
        )
        si.found_at(pi.t, valid)
        if ray.times:
            si.time = ray.time
        return si

    def revisit(self, p: Point3f, d: Vector3f, face: UInt32, full: bool = False) -> SurfaceInteraction3f:
        """The surface interaction at a stored point `p` of a face, as for a ray of direction `d`.

        uv and its derivatives are computed if BSDFs or emitters need them, or if `full`. A face that belongs to an
        instance can't be revisited: its number doesn't say which instance.
        """
        hit = PreliminaryIntersection3f.found(Float(0), face, self.geometry.shape_of(face))
        return self.surface_interaction(Ray3f(p, d), hit, full=full or self.needs_uv)

    def primitive_index(self, si: SurfaceInteraction3f) -> UInt32:
        """The primitive of its shape that `si` lies on, numbered as in Mitsuba: triangles of meshes and boxes."""
        return self.geometry.primitive_index(si.face, si.uv, si.p, self.lookup)

    # ---- BSDFs and emitters of surface points -----------------------------------------------

    def bsdf_at(self, si: SurfaceInteraction3f) -> BSDFPtr:
        """The BSDF of the shape at `si`."""
        return self.bsdf_of(si.face)

    def bsdf_of(self, face: UInt32) -> BSDFPtr:
        """The BSDF of a face."""
        return BSDFPtr.into(self._family(self.bsdfs), self._bsdf_of_face.at(face))

    def emitter_index_at(self, si: SurfaceInteraction3f) -> UInt32:
        """The number of the emitter seen at `si`; the count of emitters means none."""
        return dr.select(si.is_valid(), self._light_of_face.at(si.face), UInt32(self._light_on_miss))

    def emitter_at(self, si: SurfaceInteraction3f) -> EmitterPtr:
        """The emitter seen at `si`: that of the shape, or the environment on a miss."""
        return self.emitter_ptr(self.emitter_index_at(si))

    def emitter_ptr(self, index: UInt32) -> EmitterPtr:
        """The emitters with the numbers `index`, per lane."""
        return EmitterPtr.into(self._family(self.lights), index)


KINDS = (
    *("sensor", "integrator", "bsdf", "texture", "emitter", "shape", "sampler", "film", "rfilter"),
    *("medium", "phase", "volume"),
)
"""The kinds of plugins that may stand at the top level of a scene: as its parts, or for others to refer to."""


TRANSMITS = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission | BSDFFlags.DeltaTransmission
