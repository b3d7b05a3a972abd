"""The cases in which derivatives are known to be wrong.

Estimators of derivatives by the place of shapes leave out some of what changes in an image as a shape moves. Each case
here has been compared with closed forms or finite differences and was off, without a sign. They are refused
(`djpt.rendering.gradients.refusals`), unless an integrator's `unproven_gradients` is true.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import BSDFFlags, EmitterFlags, has_flag
from djpt.description.plugin import Plugin
from djpt.description.registry import name_of
from djpt.jit.frozen import recording
from djpt.jit.types import Point2f
from djpt.rendering.gradients.meetings import meeting_pairs
from djpt.scene.intersecting_shapes import between, encloses, is_convex
from djpt.sensors.orthographic import Orthographic
from djpt.sensors.projective import Central, ProjectiveCamera
from djpt.textures.base import textures_in
from djpt.textures.patches import seams

if TYPE_CHECKING:
    from djpt.integrators.base import Integrator
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = [
    "CASES",
    "Case",
    "Rendering",
    "far_planes",
    "moves",
    "named",
    "nested_bsdfs",
    "of_lobes",
    "unknown_outlines",
    "without_silhouettes",
]


NARROW = 0.01
"""The angle in degrees within which light ends at a cone, at least: the edge of what is sharper isn't found."""

DISTANT = 1e6
"""How far away a light at infinity is taken to be."""


@dataclass(frozen=True)
class Rendering:
    """What is to be differentiated: a scene, and how it is rendered."""

    scene: Scene
    integrator: Integrator
    moving: tuple[Any, ...]
    """The shapes whose place has gradients; not clouds of ellipsoids, which have no silhouettes by definition."""
    seen: tuple[Any, ...]
    """All shapes that rays can hit; an instance stands for its group."""
    sensor: Sensor | None
    """The sensor, if it is known."""
    camera: Sensor | None
    """The sensor, if its place has gradients."""
    lights: tuple[Any, ...]
    """The lights whose place has gradients, and whose shadows have edges: points, and parallel light."""

    @staticmethod
    def of(scene: Scene, integrator: Integrator, sensor: Sensor | None = None) -> Rendering:
        """The rendering of a scene by an integrator."""
        shapes = scene.shapes()
        moving = tuple(s for s in shapes if s.parameters_grad_enabled() and not s.is_ellipsoids())
        seen = tuple(s for s in shapes if name_of(type(s)) != "shapegroup")
        camera = sensor if sensor and sensor.attached_names() else None
        lights = tuple(e for e in scene.emitters() if e.is_moving() and has_flag(e.flags(), EmitterFlags.Delta))
        return Rendering(scene, integrator, moving, seen, sensor, camera, lights)

    def movers(self) -> tuple[Any, ...]:
        """What moves with gradients."""
        return (*self.moving, *self.lights, *([] if self.camera is None else [self.camera]))

    def passes_by(self) -> tuple[Any, ...]:
        """The shapes that may change their place in the picture: those that move, or all if the camera does."""
        return self.moving if self.camera is None else self.seen

    def bsdfs(self, *, of_moving: bool = False) -> Iterator[tuple[Any, Any]]:
        """Each shape, of those that move or are lit by lights that do, or of all, with its BSDF."""
        for shape in self.passes_by() if of_moving and not self.lights else self.scene.geometry.contents.shapes:
            if shape.bsdf() is not None:
                yield shape, shape.bsdf()

    def emitters(self, kind: int) -> Iterator[Any]:
        """The emitters that have any of some `EmitterFlags`."""
        return (emitter for emitter in self.scene.emitters() if has_flag(emitter.flags(), kind))


@dataclass(frozen=True)
class Case:
    """A case in which derivatives are wrong."""

    name: str
    """What the scene has, for the table in the guide."""
    reason: str
    """What is wrong."""
    way_out: str
    """What can be done instead."""
    found: Callable[[Rendering], Iterator[str]]
    """Yields a phrase about each node that makes it the case."""
    needs_numbers: bool = False
    """Whether the places of shapes are read, which can't be done while `dr.freeze` records."""


def named(plugin: Any) -> str:
    """A plugin in a message: its name, and what it is."""
    return f"'{plugin.id()}' ({name_of(type(plugin)) or type(plugin).__name__})"


def alone(rendering: Rendering) -> bool:
    """Whether a single convex shape is all that rays can hit."""
    return len(rendering.seen) == 1 and not recording() and is_convex(rendering.seen[0])


def of_lobes(rendering: Rendering, kind: int) -> Iterator[str]:
    """Shapes whose BSDF has any of some lobes."""
    for shape, bsdf in rendering.bsdfs():
        if has_flag(bsdf.flags(), kind):
            yield f"'{shape.id()}' has the BSDF {named(bsdf)}"


def shadows_in_mirrors(rendering: Rendering) -> Iterator[str]:
    """Smooth surfaces, and others that light passes straight through, that may show shadows in the light of points."""
    mirrors = list(of_lobes(rendering, BSDFFlags.Delta))
    if not mirrors or not rendering.movers() or direct_light_only(rendering.integrator) or alone(rendering):
        return
    for emitter in rendering.emitters(EmitterFlags.Delta):
        if not emitter.on_shape:
            for phrase in mirrors:
                yield f"{phrase}, {named(emitter)} shines"


def bent_mirrors(rendering: Rendering) -> Iterator[str]:
    """Meshes with interpolated normals that mirror or refract."""
    for shape, bsdf in rendering.bsdfs() if rendering.movers() else ():
        kinds = BSDFFlags.DeltaReflection | BSDFFlags.DeltaTransmission
        if shape.of_triangles and shape.has_vertex_normals() and has_flag(bsdf.flags(), kinds):
            yield f"'{shape.id()}' has the BSDF {named(bsdf)}"


TOLD_APART = {"sphere", "disk", "rectangle", "cylinder", "cone", "paraboloid", "cube", "cuboid", "plane"}
"""The shapes, meshes aside, of which no part stands before another one that is seen from the same side."""


def bodies_in_mirrors(rendering: Rendering) -> Iterator[str]:
    """Shapes that may stand before themselves, and smooth surfaces in which they may be seen to do so."""
    mirrors = list(of_lobes(rendering, BSDFFlags.Delta))
    if not mirrors or not rendering.movers() or alone(rendering):
        return
    for phrase in mirrors:
        for shape in rendering.scene.geometry.contents.shapes:
            kind = name_of(type(shape)) or ""
            if not shape.of_triangles and kind not in TOLD_APART and kind not in ("instance", "shapegroup"):
                yield f"'{shape.id()}' is of the type '{kind}', {phrase}"


def bent_normals(rendering: Rendering) -> Iterator[str]:
    """Moving shapes with bumps, or with a normal map that cuts off light, bends a mirror or interpolated normals."""
    for shape, bsdf in rendering.bsdfs(of_moving=True):
        smooth = shape.of_triangles and shape.has_vertex_normals()
        for nested in nested_bsdfs(bsdf):
            if nested.has_jumps(smooth):
                yield f"'{shape.id()}' has the BSDF {named(nested)}"


def nested_bsdfs(bsdf: Any) -> Iterator[Any]:
    """A BSDF, and all that are nested in it."""
    yield bsdf
    for child in (getattr(bsdf, name, None) for name in bsdf.children):
        if isinstance(child, Plugin) and child.kind == "bsdf":
            yield from nested_bsdfs(child)


def jumping_textures(rendering: Rendering) -> Iterator[str]:
    """Textures that jump on lamps and in the light of points, and volumes that do, where that isn't followed."""
    for shape in rendering.passes_by():
        lamp = shape.emitter() if lit_by_lamps_alone(rendering.integrator) else None
        for texture in (t for owner in (shape.bsdf(), shape.emitter()) if owner for t in textures_in(owner)):
            volume = getattr(texture, "volume", None)
            if getattr(volume, "filter_type", "") == "nearest":
                yield f"'{shape.id()}' has the volume {named(volume)}"
        if lamp is not None:
            for texture in textures_in(lamp):
                if texture.has_patches():
                    yield f"'{shape.id()}' has the texture {named(texture)}"
            if list(seams(shape, lamp)):
                yield f"'{shape.id()}' has the light {named(lamp)}, whose texture doesn't end as it begins"
    # What slides through the light of a texture sees its edges.
    for light in rendering.emitters(EmitterFlags.Delta) if rendering.movers() else ():
        for texture in () if light.on_shape else textures_in(light):
            if texture.has_patches():
                yield f"'{light.id()}' has the texture {named(texture)}"


def bounded_beams(rendering: Rendering) -> Iterator[str]:
    """Lights whose beams have sharp sides."""
    others_move = rendering.moving or rendering.camera is not None
    for emitter in rendering.emitters(EmitterFlags.Delta) if others_move else rendering.lights:
        narrow = getattr(emitter, "edge_width", NARROW)
        if emitter.on_shape:
            yield f"{named(emitter)} shines"
        elif narrow < NARROW and not recording():
            yield f"the beam of {named(emitter)} ends within {narrow:.2g} degrees"


def light_paths(rendering: Rendering) -> Iterator[str]:
    """Lights that turn, seen by an integrator whose paths begin there, or that has samples of its own."""
    for emitter in rendering.scene.emitters():
        if emitter.is_moving() and rendering.integrator.path_tracer.starts_at_lights:
            yield f"the integrator is '{type(rendering.integrator).__name__}', and {named(emitter)} turns"


def direct_light_only(integrator: Any) -> bool:
    """Whether surfaces are lit by emitters alone."""
    return bool(getattr(integrator, "direct_light_only", False) or getattr(integrator, "max_depth", 3) <= 2)


def lit_by_lamps_alone(integrator: Any) -> bool:
    """Whether surfaces are lit, by emitters alone, by an integrator that follows no edges of these in its paths."""
    return bool(getattr(integrator, "direct_light_only", False)) and integrator.max_depth > 1


def intersections(rendering: Rendering) -> Iterator[str]:
    """Shapes that a moving one cuts or touches, where one of both shines and no path follows the curve between them."""
    pairs = meeting_pairs(rendering.seen, rendering.passes_by()) if lit_by_lamps_alone(rendering.integrator) else ()
    for shape, other in pairs:
        if shape.emitter() is not None or other.emitter() is not None:
            yield f"'{shape.id()}' and '{other.id()}' intersect or touch"


def unknown_outlines(rendering: Rendering) -> Iterator[str]:
    """Shapes that stay, whose silhouettes aren't known, and that may hide light from a moving one."""
    still = [s for s in rendering.seen if not s.silhouette_discontinuity_types() and s not in rendering.moving]
    for shape in still:
        # An infinite plane has no edge.
        if name_of(type(shape)) == "plane":
            continue
        if rendering.camera is not None:
            yield f"'{shape.id()}' ({name_of(type(shape))}) may be seen by the camera, which moves"
        # A convex room has none that is seen from within.
        if not all(encloses(shape, moving) for moving in rendering.moving):
            for light in hidden_by(shape, rendering):
                yield f"'{shape.id()}' ({name_of(type(shape))}) may hide {light} from a shape that moves"
        if not alone(rendering) and not all(s is shape or encloses(shape, s) for s in rendering.seen):
            for light in rendering.lights:
                yield f"'{shape.id()}' ({name_of(type(shape))}) may hide {named(light)}, which moves"


def hidden_by(shape: Any, rendering: Rendering) -> Iterator[str]:
    """The lights that a shape may hide from those that move."""
    integrator, emitters = rendering.integrator, rendering.scene.emitters()
    direct = direct_light_only(integrator)
    for emitter in emitters:
        if emitter.is_environment():
            yield named(emitter)
        elif emitter.from_infinity:
            forward: Any = emitter.forward  # type: ignore[attr-defined]
            toward = DISTANT * -np.array(dr.detach(forward), np.float64).ravel()
            if any(between(shape, m.world_box(), shifted(m.world_box(), toward)) for m in rendering.moving):
                yield named(emitter)
        else:
            box = (emitter if emitter.get_shape() is None else emitter.get_shape()).bbox()
            place = np.array(box.min, np.float64).ravel(), np.array(box.max, np.float64).ravel()
            if emitter.get_shape() is not shape and any(
                between(shape, m.world_box(), place) for m in rendering.moving if m is not emitter.get_shape()
            ):
                yield named(emitter)
    if not direct:
        yield "light of other surfaces"


def far_planes(rendering: Rendering) -> Iterator[str]:
    """Shapes that reach beyond the far plane of a camera; of infinite planes, those whose horizon it may show."""
    for camera in () if rendering.sensor is None or not rendering.movers() else rendering.sensor.members():
        if not isinstance(camera, ProjectiveCamera):
            continue
        axis, origin = camera.to_world.matrix[:3, 2], camera.to_world.translation()
        for shape in rendering.seen:
            corners = np.array(list(itertools.product(*np.transpose(shape.world_box())))) - origin
            if not np.isfinite(corners).all():
                # The edge of a plane is at the far plane, and moves if the camera does.
                cut = rendering.camera is not None and shows_horizon(camera, shape)
            elif isinstance(camera, Central | Orthographic):
                cut = bool((corners @ axis).max() > camera.far_clip())
            else:
                cut = bool(np.linalg.norm(corners, axis=1).max() > camera.far_clip())
            if cut:
                yield f"'{shape.id()}' reaches beyond the 'far_clip' ({camera.far_clip():g}) of {named(camera)}"


def shows_horizon(camera: Any, plane: Any) -> bool:
    """Whether rays through the border of the film miss an infinite plane."""
    normal, offset = plane.plane()
    along, corner = np.meshgrid(np.linspace(0, 1, 17), np.arange(4), indexing="ij")
    x, y = (np.where(corner % 2 == k, along, corner // 2).ravel() for k in range(2))
    with dr.suspend_grad():
        ray = camera.ray_through(Point2f(x.astype(np.float32), y.astype(np.float32)), Point2f(0.5))
    o, d = (np.array(v, np.float64).T for v in (ray.o, ray.d))
    with np.errstate(divide="ignore"):
        t = (offset - o @ normal) / (d @ normal)
    return bool(((t <= 0) | (t > np.array(ray.maxt))).any())


def shifted(box: tuple[Any, Any], by: Any) -> tuple[Any, Any]:
    """A box elsewhere."""
    return box[0] + by, box[1] + by


def without_silhouettes(rendering: Rendering) -> Iterator[str]:
    """An integrator that follows no silhouettes."""
    still = rendering.camera is None or rendering.integrator.follows_camera
    if (rendering.moving or rendering.lights or not still) and not rendering.integrator.follows_silhouettes:
        yield f"the integrator '{type(rendering.integrator).__name__}' follows no silhouettes"


CASES: tuple[Case, ...] = (
    Case(
        "an integrator without silhouettes",
        "what appears and disappears at the outlines of shapes is left out",
        "render with 'direct_projective' or 'prb_projective'",
        without_silhouettes,
    ),
    Case(
        "smooth mirrors, glass, plastic and `mask`, in the light of points and parallel light, if paths have more than "
        "two edges; unless one convex shape is all",
        "the edges of shadows aren't followed that are seen in them or through them",
        "use a small area light or a rough material, or set 'max_depth' to 2",
        shadows_in_mirrors,
    ),
    Case(
        "smooth mirrors, glass and plastic that are meshes with interpolated normals",
        "the edges at which rays leave its triangles on the wrong side aren't followed",
        "give the mesh 'face_normals', or use a rough material",
        bent_mirrors,
    ),
    Case(
        "smooth mirrors, glass, plastic and `mask` beside a `torus`, a curve or an implicit surface",
        "its parts aren't told apart that hide each other in what smooth surfaces show",
        "use a mesh",
        bodies_in_mirrors,
    ),
    Case(
        "on a shape that moves: a bump map; a normal map on a smooth mirror, glass or plastic, on a mesh with "
        "interpolated normals, or without `use_shadowing_function`",
        "where slopes change from texel to texel, or bent normals cut off light, it jumps, and that isn't followed",
        "use a normal map with its defaults on a rough material, of meshes with 'face_normals', or a mesh with the "
        "detail in its vertices",
        bent_normals,
    ),
    Case(
        "a lamp with a `checkerboard` or another texture that jumps, by 'direct_projective'; a `projector` with one; a "
        "volume with the filter `nearest` as a texture",
        "the edges between its colours aren't followed",
        "use the filter 'bilinear' or 'trilinear', or, for lamps, render with 'prb_projective'",
        jumping_textures,
    ),
    Case(
        "a `directionalarea` light, or a `spot` with a sharp edge",
        "the sides of its beam aren't followed",
        "use a 'spot' light whose 'beam_width' is less than its 'cutoff_angle', or a small area light",
        bounded_beams,
    ),
    Case(
        "a camera whose far plane cuts or hides a shape; an infinite `plane` whose horizon a camera sees that moves",
        "what ends there isn't followed",
        "give 'far_clip' a larger value, and in place of the plane a large rectangle",
        far_planes,
        needs_numbers=True,
    ),
    Case(
        "a light that moves or turns, rendered by paths that begin at lights",
        "how these paths move isn't followed",
        "render with 'path', 'volpath' or 'prb_projective'",
        light_paths,
    ),
    Case(
        "a moving shape that cuts or touches another one, if one of them shines, by 'direct_projective'",
        "the light near the curve in which they meet isn't followed",
        "leave a gap between them, or render with 'prb_projective'",
        intersections,
        needs_numbers=True,
    ),
    Case(
        "a `linearcurve` or implicit surface, if it may hide light from a moving shape, or that of a light that moves",
        "its outlines and the edges of its shadows aren't followed",
        "use a mesh, or of curves a 'bsplinecurve'",
        unknown_outlines,
        needs_numbers=True,
    ),
)
"""The cases of shapes, lights and cameras that move, those that are found fastest first."""


def moves(scene: Scene, sensor: Sensor | None) -> bool:
    """Whether the place of a shape, a light or the sensor has gradients."""
    movers = (
        *(shape.parameters_grad_enabled() for shape in scene.shapes()),
        *(e.is_moving() for e in scene.emitters()),
    )
    return any(movers) or bool(sensor and sensor.attached_names())
