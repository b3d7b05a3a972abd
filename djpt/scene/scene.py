"""The scene: plugins compiled into what kernels read; edits, and views of it."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np

from djpt.core.numeric import whole
from djpt.core.records import EmitterFlags, has_flag
from djpt.core.records.record import note_latest
from djpt.description.parameters import SCENES
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Merging, Properties
from djpt.description.registry import registered
from djpt.dispatch.ensemble import Detached, Lookup
from djpt.emitters import Emitter
from djpt.errors import RenderError, SceneError, near_miss
from djpt.geometry.aggregate import Geometry, unseen
from djpt.jit.frozen import recording, require_editable
from djpt.jit.kernels import may_wait
from djpt.jit.types import Float, Point3f, TensorXf, UInt32
from djpt.materials import BSDF, Diffuse
from djpt.scene.lights import BSDFs, Lights
from djpt.scene.media_placement import Media, absorbing_sides, all_sides
from djpt.scene.mitsuba_api import MitsubaScene
from djpt.scene.silhouettes import Silhouettes
from djpt.scene.touching_shapes import Bodies
from djpt.sensors import Sensor
from djpt.shapes import Shape
from djpt.shapes.numbering import merged_last
from djpt.textures.base import check_textures

__all__ = ["Renderer", "Scene", "find_sensor", "require_scene"]


def collect_emitters(plugins: Iterable[Plugin]) -> list[Emitter]:
    """The emitters of a scene's `plugins`, in their order.

    A shape's emitter is numbered where the shape stands, whether it is nested there or the shape refers to an area
    light that stands in the scene: the latter by itself doesn't count. Emitters of shapes learn their `shape`. A
    warning tells of area lights that no shape refers to.

    Raises:
        SceneError: A shape's emitter can't be nested, or belongs to two shapes; or a shape that emits light stands in
            the scene twice.
    """
    found: list[Emitter] = []
    of_shapes: list[Emitter] = []
    for plugin in plugins:
        if isinstance(plugin, Shape) and plugin.emitter() is not None:
            adopt(plugin, plugin.emitter())
            if plugin.emitter() in found:
                raise SceneError(f"{plugin.id()}: a shape that emits light can't appear in the scene twice")
            found.append(plugin.emitter())
        elif isinstance(plugin, Emitter):
            (of_shapes if plugin.on_shape else found).append(plugin)
    for emitter in of_shapes:
        if emitter.shape is None:
            warnings.warn(f"{emitter.id()}: no shape refers to this emitter, so it emits no light", stacklevel=2)
    return found


def collect_sensors(plugins: Iterable[Plugin]) -> list[Sensor]:
    """The sensors of a scene's `plugins`, in their order.

    Those of shapes learn their `shape`. One that stands in the scene, and that a shape refers to, has two numbers.

    Raises:
        SceneError: A shape's sensor can't be nested, or belongs to two shapes.
    """
    found: list[Sensor] = []
    for plugin in plugins:
        if isinstance(plugin, Shape) and plugin.sensor() is not None:
            found.append(adopt(plugin, plugin.sensor()))
        elif isinstance(plugin, Sensor):
            found.append(plugin)
    return found


def adopt(shape: Shape, nested: Any) -> Any:
    """An emitter or sensor of a shape, nested or by reference, with its shape set."""
    if not nested.on_shape:
        fitting = (name for name, plugin in registered(nested.kind).items() if getattr(plugin, "on_shape", False))
        hint = near_miss("", fitting)
        raise SceneError(f"{shape.id()}: the {nested.kind} '{nested.id()}' can't be nested in a shape{hint}")
    if nested.shape not in (None, shape):
        raise SceneError(f"{shape.id()}: its {nested.kind} already belongs to '{nested.shape.id()}'")
    nested.shape = shape
    return nested


def numbers(shapes: Iterable[Shape], emitters: Sequence[Emitter]) -> tuple[list[BSDF], list[int], list[int]]:
    """The BSDFs of shapes, each once; per shape the number of its BSDF, and that of its emitter.

    The number of emitters stands for none.
    """
    bsdfs: list[BSDF] = []
    bsdf_of_shape: list[int] = []
    emitter_of_shape: list[int] = []
    for shape in shapes:
        if unseen(shape):
            bsdf_of_shape.append(0)
            emitter_of_shape.append(len(emitters))
            continue
        bsdf = shape.bsdf()
        if bsdf not in bsdfs:
            bsdfs.append(bsdf)
        bsdf_of_shape.append(bsdfs.index(bsdf))
        emitter_of_shape.append(len(emitters) if shape.emitter() is None else emitters.index(shape.emitter()))
    return bsdfs, bsdf_of_shape, emitter_of_shape


def black(name: str) -> BSDF:
    """A surface that reflects nothing."""
    return Diffuse(Properties("diffuse", name, {"reflectance": 0.0}))


WITHOUT_EFFECT = ("allow_thread_reordering", "compact_acceleration_structures", "embree_use_robust_intersections")
"""Mitsuba's settings for ray queries of its own, which descriptions may hold."""


class Renderer(Protocol):
    """The renderer of a scene: `djpt.rendering`, which is built on scenes and gives itself to each that it makes."""

    def prepare_to_record(self, scene: Scene) -> None:
        """Make what can't be made while a frozen function is recorded that renders the scene."""

    def film_image(self, scene: Scene, sensor: Any, integrator: Any, seed: Any, spp: int) -> TensorXf:
        """The image (H, W, C) of an integrator, whose derivatives use the samples of the image."""

    def image_derivative(
        self, scene: Scene, integrator: Any, sensor: Any, seed: Any, spp: int, grad: TensorXf | None
    ) -> TensorXf:
        """The derivative of an image: see `djpt.rendering.image.image_derivative`."""


class Scene(MitsubaScene):
    """Shapes, emitters, sensors and an integrator, ready to render.

    Lights and sensors are numbered in the order of the description, except that those of rectangles, cubes and other
    meshes without attributes come last unless `djpt.load_dict` was told not to optimise: see `djpt.shapes.numbering`.
    """

    def __init__(self, props: Properties, renderer: Renderer | None = None) -> None:
        super().__init__(props)
        self._renderer = renderer
        for setting in WITHOUT_EFFECT:
            props.boolean(setting, False)
        props.children("animation")  # for others to refer to
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
        infinite = sum(emitter.is_environment() for emitter in self._emitters)
        if infinite > 1:
            raise SceneError(f"{props.node}: only one environment emitter is possible, found {infinite}")
        self.moves = (
            any(emitter.carrier is not None for emitter in self._emitters)
            or any(sensor.moves for sensor in self._sensors)
            or any(shape.moves for shape in self._shapes)
        )
        """Whether something moves: a shape, a light or a sensor."""
        self.in_time = self.moves or any(emitter.in_time for emitter in self._emitters)
        """Whether rays need a time, because what they meet depends on it."""
        with may_wait():
            self._compile()
        SCENES[self] = frozenset()

    def _numbered(self, merging: Merging | None) -> list[Plugin]:
        """The plugins in the order in which Mitsuba numbers them: those that its loader merges with others are last."""
        if merging is None:
            return [plugin for _, plugin in self.named]
        existed = [plugin for key, plugin in self.named if key not in merging.keys]
        return existed + merged_last((plugin for key, plugin in self.named if key in merging.keys), merging.alike)

    @property
    def renderer(self) -> Renderer:
        """The renderer of the scene.

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
        self.normalized: Any = ()
        """The scene that is rendered in the place of this one, see `djpt.scene.normalization.normalized_scene`; ():
        not known yet."""
        self.geometry = self._compiled_geometry()
        shapes = self.geometry.contents.shapes
        bsdfs, bsdf_of_shape, emitter_of_shape = numbers(shapes, self._emitters)
        self.lights = Lights(self._emitters, emitter_of_shape, self.geometry, self.lookup)
        # A scene without surfaces still traces the code of a vertex: that needs a BSDF to ask.
        self.bsdfs = BSDFs(bsdfs or [black(f"{self.id()}.bsdf")], bsdf_of_shape, self.geometry, self.lookup)
        self.silhouettes = Silhouettes(self._shapes, self.lookup)
        self._find_media()
        check_textures(shapes)
        self._set_bounds()
        self._families = {}
        self._prepare()
        self.camera_medium = UInt32(self.media.vacuum) if self.media else None
        self.near_clip_fraction = Float(0)
        self.bodies: Bodies | None = None
        for shape in self._shapes:
            shape.used_in(self)
        note_latest(self)

    def _compiled_geometry(self) -> Geometry:
        """The shapes, compiled for ray queries."""
        overlap = any(shape.priority is not None for shape in self._shapes)
        if any(shape.moves for shape in self._shapes):
            if overlap:
                raise SceneError(f"{self.id()}: shapes can't move in scenes in which one has a 'priority'")
            from djpt.geometry.moving import MovingGeometry  # few scenes need it

            return MovingGeometry(self._shapes)
        # A light that moves has no position that walls could be compared with.
        open_sky = any(e.from_infinity or e.carrier is not None for e in self._emitters)
        if overlap:
            from djpt.geometry.overlapping import OverlappingGeometry  # nor this

            return OverlappingGeometry(self._shapes, self._light_positions(), open_sky)
        return Geometry(self._shapes, self._light_positions(), open_sky)

    def renew_bsdfs(self) -> None:
        """Follow a change of a shape's BSDF."""
        bsdfs, of_shape, _ = numbers(self.geometry.contents.shapes, self._emitters)
        self.bsdfs = BSDFs(bsdfs, of_shape, self.geometry, self.lookup)
        self._find_media()
        self.silhouettes.forget()
        self._families.clear()
        self._prepare()
        self.normalized = ()

    def _find_media(self) -> None:
        """Number the media of shapes and sensors."""
        shapes = self.geometry.contents.shapes
        self.geometry.follow_bsdfs()
        kind: type[Media] = Media
        if self.geometry.overlaps:
            from djpt.scene.overlapping_media import OverlappingMedia  # few scenes need it

            kind = OverlappingMedia
        self.media = self.every_medium = kind(self.geometry, self.lookup, absorbing_sides(shapes))
        sensors = [s for sensor in self._sensors for s in (sensor, *sensor.delegates())]
        of_sensors = [sensor.get_medium() for sensor in sensors if sensor.get_medium() is not None]
        if of_sensors or any(shape.is_medium_transition() for shape in shapes):
            self.every_medium = kind(self.geometry, self.lookup, all_sides(shapes), of_sensors)

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
        self.differentiated = [(i, shape) for i, shape in enumerate(shapes) if shape.parameters_grad_enabled()]
        for part in (self.bsdfs, self.lights, self.media, self.every_medium):
            part.prepare()
        for ensemble in (*self.geometry.every_ensemble, *self.ensembles(), *self.every_medium.ensembles):
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
        if not all(ensemble.is_current() for ensemble in (self.bsdfs.ensemble, *self.every_medium.ensembles)):
            self._find_media()
        self.bsdfs.forget()
        self.lights.forget()
        self.silhouettes.forget()
        shapes = [plugin for plugin in changed if isinstance(plugin, Shape)]
        moved = any(plugin.kind == "animation" for plugin in changed)
        if shapes or moved:
            self.geometry.move(shapes)
        if any(isinstance(plugin, Emitter) for plugin in changed):
            self.geometry.move_points(self._light_positions())
        if shapes or moved:
            self._set_bounds()
        if shapes or moved or any(plugin.kind in ("emitter", "texture", "volume") for plugin in changed):
            self.lights.forget_choices()
        self._prepare()
        self._refresh_normalized(changed)

    def _refresh_normalized(self, changed: Sequence[Plugin]) -> None:
        """Let the normalized copy follow an edit; it shares most materials and textures, and has copies of all else."""
        if self.normalized and all(
            plugin.kind in ("bsdf", "texture") and self.normalized[0].shares(plugin) for plugin in changed
        ):
            self.normalized[1].refresh(changed)
        elif self.normalized or any(isinstance(plugin, Shape) for plugin in changed):
            self.normalized = ()

    def prepare_to_record(self) -> None:
        if not recording():
            self.renderer.prepare_to_record(self)

    # ---- views ------------------------------------------------------------------------

    def replace(
        self,
        *,
        lookup: Lookup | None = None,
        geometry: Geometry | None = None,
        emitter_choice: str | None = None,
        all_media: bool = False,
        sensor: Sensor | None = None,
        near_clip_fraction: Float | None = None,
        silhouettes_of: Sequence[Shape] | None = None,
        bodies: Bodies | None = None,
    ) -> Scene:
        """A view of this scene with other parts, or the scene itself if nothing changes.

        Args:
            lookup: Another way to read the plugins' values.
            geometry: What rays hit; it must number faces and shapes in the same way.
            emitter_choice: Another way to choose emitters: see `djpt.emitters.light_samplers`.
            all_media: Whether all media are followed along rays, not only those that absorb without scattering.
            sensor: The sensor that rays come from: it tells where they start, and in which medium.
            near_clip_fraction: How far from the sensor its rays start: see `Sensor.near_clip_fraction`.
            silhouettes_of: The shapes whose silhouettes are followed.
            bodies: The shapes that derivatives take for parts of one body.
        """
        lights = self.lights.replace(lookup, emitter_choice)
        more_media = all_media and self.media is not self.every_medium
        given = (geometry, sensor, near_clip_fraction, silhouettes_of, bodies)
        if lights is self.lights and not more_media and all(part is None for part in given):
            return self
        view = copy.copy(self)
        view.is_view, view.lights, view._families = True, lights, {}
        note_latest(view)
        if lookup is not None:
            view.lookup, view.bsdfs = lookup, self.bsdfs.replace(lookup)
            view.silhouettes = self.silhouettes.replace(lookup)
            view.media = view.every_medium = self.every_medium.replace(lookup)
            if self.media is not self.every_medium:
                view.media = self.media.replace(lookup)
        if geometry is not None:
            view.geometry = geometry
        if silhouettes_of is not None:
            view.silhouettes = view.silhouettes.following(silhouettes_of)
        if bodies is not None:
            view.bodies = bodies
        if near_clip_fraction is not None:
            view.near_clip_fraction = near_clip_fraction
        if more_media:
            view.media = view.every_medium
            view.camera_medium = UInt32(view.media.vacuum)
        if sensor is not None:
            view.geometry = view.geometry.seen_from(sensor.starts())
            view.has_image_circle = sensor.has_image_circle
            if view.media:
                view.camera_medium, view.outer_medium = view.media.of_sensor(sensor)
        return view


KINDS = (
    *("sensor", "integrator", "bsdf", "texture", "emitter", "shape", "sampler", "film", "rfilter"),
    *("medium", "phase", "volume"),
)
"""The kinds of plugins that may stand at the top level of a scene: as its parts, or for others to refer to."""


def require_scene(scene: Any) -> Scene:
    """The scene itself; raises `RenderError` if it isn't one."""
    if not isinstance(scene, Scene):
        raise RenderError(f"render() expects a scene from load_dict(), found {type(scene).__name__}")
    return scene


def find_sensor(scene: Scene, sensor: Any) -> Sensor:
    """The sensor to render: one of the scene, by number, or another one, which takes the size of the scene."""
    require_scene(scene)
    sensors = scene.sensors()
    if not isinstance(sensor, Sensor):
        number = whole(sensor)
        if number is None:
            raise RenderError(f"'sensor' must be an index or a sensor, found {type(sensor).__name__}")
        if not sensors:
            raise RenderError("the scene has no sensor: add one, for example {'type': 'perspective'}")
        if not 0 <= number < len(sensors):
            raise RenderError(f"there is no sensor {number}: the scene has {len(sensors)}, numbered from 0")
        sensor = sensors[number]
    found: Sensor = sensor
    if found.on_shape and found.shape is None:
        raise RenderError(f"'{found.id()}' must be nested in a shape of the scene to be rendered")
    if found not in sensors:
        found.set_bounds(*scene.bounding_sphere())
    return found
