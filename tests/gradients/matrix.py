"""The gradient matrix: derivatives of small images by each kind of parameter, compared with central differences."""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, TensorXf
from tests.gradients.camera_scenes import cameras_of_scenes
from tests.gradients.cells import GUIDE, MOST_SEEDS, Cell, Edit, Node, camera_above, moved
from tests.kit import emitters, materials
from tests.silhouettes.test_projective import globe

__all__ = ["CELLS"]

# ---------------------------------------------------------------- what depends on theta


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Callable[[Float], Any]:
    return lambda theta: djpt.Transform4f().translate([x * theta, y * theta, z * theta])


def turn(axis: tuple[float, float, float], degrees: float = 40.0) -> Callable[[Float], Any]:
    return lambda theta: djpt.Transform4f().rotate(list(axis), degrees * theta)


def grown(theta: Float) -> Any:
    return djpt.Transform4f().scale([1 + theta, 1 + theta, 1 + theta])


def changed(key: str) -> Edit:
    """Numbers of a parameter, of which each changes in proportion to its size, some more and some less."""

    def edit(params: Any, theta: Float) -> None:
        value = params[key]
        numbers = np.array(value, np.float64)
        slope = np.random.default_rng(0).uniform(0.5, 1, numbers.shape) * np.maximum(np.abs(numbers), 0.1)
        # Off the ends of all ranges.
        start, slope = ((0.8 * numbers + 0.04).astype(np.float32), (0.5 * slope).astype(np.float32))
        kind = type(value)
        wide = kind(start) if numbers.ndim != 0 else kind(float(start))
        params[key] = (
            wide + kind(slope) * theta if not dr.is_tensor_v(kind) else wide + TensorXf(slope) * TensorXf(theta)
        )

    return edit


# ---------------------------------------------------------------- scenes


def spots(seed: int = 0) -> Node:
    data = 0.2 + 0.7 * np.random.default_rng(seed).random((5, 5, 3), np.float32)
    return {"type": "bitmap", "data": TensorXf(data), "raw": True}


def sky() -> Node:
    """A smooth environment."""
    row, column = np.arange(16)[:, None, None], np.arange(32)[None, :, None]
    radiance = 0.3 + np.abs(np.sin(0.3 * row + column * (np.pi / 16))) * np.ones((1, 1, 3))
    return {"type": "envmap", "bitmap": djpt.Bitmap(radiance.astype(np.float32))}


@functools.cache
def globe_file() -> str:
    """A PLY file of a smooth sphere, with texture coordinates as seen along z."""
    path = Path(tempfile.mkdtemp(prefix="djpt-")) / "globe.ply"
    atexit.register(shutil.rmtree, path.parent, ignore_errors=True)
    data = globe().data()
    djpt.Mesh("globe", data.positions, data.indices, data.normals, 0.5 + 0.5 * data.positions[:, :2]).write_ply(path)
    return str(path)


TUBE = Path(__file__).parent / "tube.txt"
"""A bent curve of four segments, with open ends."""
FLOOR = {
    "type": "rectangle",
    "to_world": T().translate([0, 0, -1]).scale(5),
    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.5, 0.4]}},
}
LIGHTS: dict[str, Callable[[], Node]] = {
    "lamp": lambda: {
        "light": {
            "type": "sphere",
            "center": [2.5, 2, 5],
            "radius": 0.7,
            "emitter": {"type": "area", "radiance": 20.0},
        }
    },
    "point": lambda: {"light": {"type": "point", "position": [2.5, 2, 5], "intensity": 30.0}},
    "parallel": lambda: {"light": {"type": "directional", "direction": [-0.5, -0.4, -1], "irradiance": 2.0}},
    "sky": lambda: {"light": {"type": "constant", "radiance": 0.8}},
    "map": lambda: {"light": sky()},
}
TILTED = T().translate([0.2, 0.1, 0.4]).rotate([0.48, 0.6, 0.64], 50).scale(0.6)
SHAPES: dict[str, Callable[[], Node]] = {
    "sphere": lambda: {"type": "sphere", "center": [0.2, 0.1, 0.4], "radius": 0.8},
    "disk": lambda: {"type": "disk", "to_world": T().translate([0.2, 0.1, 0.4]).rotate([0.8, 0.6, 0], 20)},
    "rectangle": lambda: {"type": "rectangle", "to_world": T().translate([0.2, 0.1, 0.4]).rotate([0.8, 0.6, 0], 20)},
    "cylinder": lambda: {"type": "cylinder", "p0": [-0.6, 0, 0.3], "p1": [0.7, 0.2, 0.5], "radius": 0.4},
    "cube": lambda: {
        "type": "cube",
        "to_world": T().translate([0.2, 0.1, 0.4]).rotate([0.48, 0.6, 0.64], 50).scale(0.6),
    },
    "mesh": lambda: {"type": "ply", "filename": globe_file(), "to_world": T().translate([0.2, 0.1, 0.4]).scale(0.8)},
    "cone": lambda: {"type": "cone", "to_world": T().translate([0.2, 0.1, 0]).scale(0.8)},
    "torus": lambda: {"type": "torus", "to_world": T().translate([0.2, 0.1, 0.4]).scale(0.8)},
    "tube": lambda: {"type": "bsplinecurve", "filename": str(TUBE), "to_world": T().translate([0.2, 0.1, 0.4])},
    "paraboloid": lambda: {"type": "paraboloid", "to_world": T().translate([0.2, 0.1, 0]).scale(0.7)},
    "cuboid": lambda: {
        "type": "cuboid",
        "to_world": T().translate([0.2, 0.1, 0.4]).rotate([0.48, 0.6, 0.64], 50).scale(0.6),
    },
}
MOTIONS: dict[str, Callable[[Float], Any]] = {
    "aside": shift(0.8, 0.3),
    "up": shift(0, 0, 1),
    "turn": turn((0.64, 0.6, 0.48)),
    "grow": grown,
}
VIEWS = {"aside": shift(0.5, 0.2, 0), "near": shift(0, 0, 1), "turn": turn((0.6, 0.8, 0), 10)}
"""How cameras move."""
SURFACES: dict[str, Callable[[], Node]] = {
    "diffuse": lambda: {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.3]}},
    "textured": lambda: {"type": "diffuse", "reflectance": spots()},
    "checkerboard": lambda: {"type": "diffuse", "reflectance": {"type": "checkerboard"}},
    "texels": lambda: {"type": "diffuse", "reflectance": {**spots(), "filter_type": "nearest"}},
    "half a texture": lambda: {
        "type": "diffuse",
        "reflectance": {**spots(), "to_uv": T().scale([1.5, 1, 1]), "wrap_mode": "mirror"},
    },
    "rough metal": lambda: {"type": "roughconductor", "alpha": 0.3},
    "brushed metal": lambda: {"type": "roughconductor", "alpha_u": 0.15, "alpha_v": 0.5},
    "rough glass": lambda: {"type": "roughdielectric", "alpha": 0.3},
    "plastic": lambda: {"type": "plastic"},
    "rough plastic": lambda: {"type": "roughplastic", "alpha": 0.3},
    "principled": lambda: {"type": "principled", "roughness": 0.5, "metallic": 0.5, "base_color": spots()},
    "mirror": lambda: {"type": "conductor"},
    "glass": lambda: {"type": "dielectric"},
    "mask": lambda: {"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}},
    "null": lambda: {"type": "null"},
    "normal map": lambda: {
        "type": "normalmap",
        "normalmap": materials.bitmap(materials.normals(4, 4)),
        "nested": {"type": "diffuse"},
    },
}
DIRECT = {"type": "direct_projective"}
PATHS = {"type": "prb_projective", "max_depth": 3}


def stage(light: str, **nodes: Callable[[], Node] | Node) -> Callable[[], Node]:
    """A floor, a light and other things."""

    def make() -> Node:
        return {"floor": FLOOR, **LIGHTS[light](), **{k: n() if callable(n) else n for k, n in nodes.items()}}

    return make


def body(shape: str, surface: str) -> Callable[[], Node]:
    return lambda: {**SHAPES[shape](), "bsdf": SURFACES[surface]()}


# ---------------------------------------------------------------- the cells


def moving_shapes() -> Iterator[Cell]:
    """Each shape under each light, and each motion."""
    for shape in SHAPES:
        for light in LIGHTS:
            yield Cell(
                "a shape that moves",
                f"{shape}, aside, {light}",
                stage(light, body=body(shape, "diffuse")),
                moved("body.to_world", MOTIONS["aside"]),
                DIRECT,
            )
        for motion in ("up", "turn", "grow"):
            yield Cell(
                "a shape that moves",
                f"{shape}, {motion}, lamp",
                stage("lamp", body=body(shape, "diffuse")),
                moved("body.to_world", MOTIONS[motion]),
                DIRECT,
            )


def moving_surfaces() -> Iterator[Cell]:
    """Each material on a ball and a mesh that move, in direct and in indirect light."""
    for surface in SURFACES:
        for shape, light, integrator in (("sphere", "lamp", DIRECT), ("mesh", "map", DIRECT), ("sphere", "sky", PATHS)):
            yield Cell(
                "a material that moves",
                f"{surface}, {shape}, {light}",
                stage(light, body=body(shape, surface)),
                moved("body.to_world", MOTIONS["aside"]),
                integrator,
            )


def meeting_shapes() -> Iterator[Cell]:
    """Shapes that cut each other or stand on each other, as the camera and other surfaces see them."""
    sunk = {"type": "sphere", "center": [0.2, 0.1, -0.7], "radius": 0.8, "bsdf": SURFACES["diffuse"]()}
    standing = {
        "type": "cube",
        "to_world": T().translate([0.2, 0.1, -0.4]).rotate([0, 0, 1], 30).scale(0.6),
        "bsdf": SURFACES["diffuse"](),
    }
    for name, node, motions in (
        ("a ball in the floor", sunk, ("aside", "up")),
        ("a box on the floor", standing, ("aside",)),
    ):
        for motion in motions:
            for light, integrator in (("lamp", DIRECT), ("sky", DIRECT), ("lamp", PATHS)):
                yield Cell(
                    "shapes that meet",
                    f"{name}, {motion}, {light}",
                    stage(light, body=node),
                    moved("body.to_world", MOTIONS[motion]),
                    integrator,
                )


def moving_receivers() -> Iterator[Cell]:
    """A floor that rises under a shadow."""
    for light in LIGHTS:
        yield Cell(
            "a floor that rises",
            light,
            stage(light, body=body("sphere", "diffuse")),
            moved("floor.to_world", MOTIONS["up"]),
            DIRECT,
        )


def moving_lights() -> Iterator[Cell]:
    """Lights that move."""
    down = T().look_at([2.5, 2, 5], [0, 0, 0], [0, 1, 0])
    cases: dict[str, tuple[Node, str, Callable[[Float], Any]]] = {}
    shining = {"emitter": {"type": "area", "radiance": 20.0}}
    for shape in ("sphere", "disk", "rectangle", "cylinder", "mesh"):
        place = T().translate([2.5, 2, 5]).rotate([0, 1, 0], 200).scale(0.7)
        node = {**SHAPES[shape](), **shining}
        for key in ("center", "radius", "p0", "p1"):
            node.pop(key, None)
        cases[f"a lamp, {shape}"] = ({**node, "to_world": place}, "light.to_world", shift(1, 0.4, 0))
    textured = {"type": "rectangle", "to_world": T().translate([0, 0, 5]).rotate([1, 0, 0], 180)}
    textured["emitter"] = {"type": "area", "radiance": spots()}
    chequered = {**textured, "emitter": {"type": "area", "radiance": {"type": "checkerboard", "color0": 3.0}}}
    cases["a lamp with a checkerboard"] = (chequered, "light.to_world", shift(1, 0.4, 0))
    cases["a lamp with a texture"] = (textured, "light.to_world", shift(1, 0.4, 0))
    spot = {"type": "spot", "to_world": down, "intensity": 40.0, "cutoff_angle": 30.0}
    cases["spot, aside"] = (spot, "light.to_world", shift(1, 0.4, 0))
    cases["spot, turn"] = (spot, "light.to_world", lambda t: shift(0, 0, 0)(t) @ turn((0, 1, 0), 10)(t))
    cases["parallel, turn"] = (LIGHTS["parallel"]()["light"], "light.to_world", turn((0, 1, 0), 20))
    cases["projector, aside"] = (
        {"type": "projector", "to_world": down, "scale": 30.0},
        "light.to_world",
        shift(1, 0, 0),
    )
    cases["map, turn"] = (sky(), "light.to_world", turn((0.48, 0.8, 0.36)))
    for name, (node, key, motion) in cases.items():
        for integrator in (DIRECT, PATHS):
            yield Cell(
                "a light that moves",
                name,
                lambda node=node: {"floor": FLOOR, "light": node, "body": body("sphere", "diffuse")()},
                moved(key, motion),
                integrator,
            )
    for integrator in (DIRECT, PATHS):
        yield Cell("a light that moves", "point", stage("point", body=body("sphere", "diffuse")), at_point, integrator)

    for name, more in (
        ("wide", {"sun_aperture": 20.0}),
        ("with a dark edge", {"sun_aperture": 20.0, "complex_sun": True}),
    ):
        sun = {"type": "sunsky", "sun_direction": [-1, 1.2, 2.2], "sun_scale": 0.3, **more}
        for integrator in ({"type": "prb", "max_depth": 3}, DIRECT):
            yield Cell(
                "a light that moves",
                f"a sun, {name}",
                lambda sun=sun: {"floor": FLOOR, "light": sun, "body": body("sphere", "diffuse")()},
                toward_sun,
                integrator,
                spp=8192,
            )


def toward_sun(params: Any, theta: Float) -> None:
    start = djpt.Vector3f(params["light.sun_direction"])
    params["light.sun_direction"] = turn((0.48, 0.8, 0.36), 20)(theta).transform_affine(start)


def at_point(params: Any, theta: Float) -> None:
    params["light.position"] = djpt.Point3f(params["light.position"]) + djpt.Vector3f(theta, 0.4 * theta, 0)


def cameras() -> Iterator[Cell]:
    """Cameras that move or zoom."""
    kinds: dict[str, tuple[Callable[[], Node], tuple[str, ...]]] = {
        "perspective": (camera_above, ("x_fov", "principal_point_offset_x")),
        "thinlens": (
            lambda: {**camera_above(), "type": "thinlens", "aperture_radius": 0.3, "focus_distance": 5.0},
            ("x_fov", "aperture_radius", "focus_distance"),
        ),
        "orthographic": (flat_camera, ()),
    }
    for kind, (make, numbers) in kinds.items():
        edits = {name: moved("sensor.to_world", motion) for name, motion in VIEWS.items()}
        edits |= {number: number_of_camera(f"sensor.{number}") for number in numbers}
        for name, edit in edits.items():
            for light, integrator in (("point", DIRECT), ("map", PATHS)):
                yield Cell(
                    "a camera",
                    f"{kind}, {name}, {light}",
                    stage(light, body=body("sphere", "textured")),
                    edit,
                    integrator,
                    camera=make,
                )


def cameras_over_fields() -> Iterator[Cell]:
    """A camera that moves over a floor with many fields."""
    fields = {"type": "checkerboard", "to_uv": T().scale([8, 8, 1]), "color0": 0.8, "color1": 0.1}
    floor = {**FLOOR, "bsdf": {"type": "diffuse", "reflectance": fields}}
    for name, motion in VIEWS.items():
        for light, integrator in (("point", DIRECT), ("map", PATHS)):
            nodes = stage(light, floor=floor, body=body("sphere", "texels"))
            yield Cell("a camera", f"fields, {name}, {light}", nodes, moved("sensor.to_world", motion), integrator)


def cameras_in_media() -> Iterator[Cell]:
    """Cameras that move in fog, or before a body of a medium."""
    edits = {name: moved("sensor.to_world", motion) for name, motion in VIEWS.items()}
    edits["x_fov"] = number_of_camera("sensor.x_fov")
    fog = {"type": "cube", "to_world": T().scale(9), "bsdf": {"type": "null"}, "interior": {**THIN, "sigma_t": 0.08}}
    scenes = {f"a {name} ball": filled(name) for name in MEDIA} | {
        "fog": stage("lamp", body=body("sphere", "diffuse"), fog=lambda: fog)
    }
    for scene, nodes in scenes.items():
        for name, edit in edits.items():
            integrator = {"type": "prbvolpath", "max_depth": 4}
            yield Cell("a camera in media", f"{scene}, {name}", nodes, edit, integrator, spp=8192)
    for name in ("x_fov", "aperture_radius", "focus_distance"):
        lens = {**camera_above(), "type": "thinlens", "aperture_radius": 0.3, "focus_distance": 5.0}
        edit, integrator = number_of_camera(f"sensor.{name}"), {"type": "volpath", "max_depth": 3}
        camera = lambda lens=lens: lens  # noqa: E731
        yield Cell(
            "a camera in media", f"fog, a lens, {name}", scenes["fog"], edit, integrator, spp=8192, camera=camera
        )
    aside = edits["aside"]
    yield Cell("a camera in media", "fog, orthographic, aside", scenes["fog"], aside, integrator, camera=flat_camera)


def number_of_camera(key: str) -> Edit:
    def edit(params: Any, theta: Float) -> None:
        value = float(np.array(params[key]).ravel()[0])
        params[key] = Float(value) + max(abs(value), 0.2) * theta

    return edit


def flat_camera() -> Node:
    node = {**camera_above(), "type": "orthographic"}
    node["to_world"] = node["to_world"] @ T().scale([2.5, 2.5, 1])
    del node["fov"]
    return node


def parameters() -> Iterator[Cell]:
    """All differentiable parameters of materials, lights and media that aren't places."""
    groups: list[tuple[str, str, str, dict[str, Callable[[], Node]]]] = [
        ("a material", "body.bsdf.", "prb", {name: shaded(name) for name in first_of(materials)}),
        ("a light", "light.", "prb", {name: lit(name) for name in first_of(emitters)}),
        ("a medium", "body.interior_medium.", "prbvolpath", {name: filled(name) for name in MEDIA}),
    ]
    for group, start, kind, scenes in groups:
        for name, nodes in scenes.items():
            for key in differentiable(nodes, start):
                integrator = {"type": kind, "max_depth": 5}
                yield Cell(group, f"{name}, {key[len(start) :]}", nodes, changed(key), integrator, step=0.02, spp=8192)


PLACES = ("to_world", "position", "vertex_positions", "vertex_normals", "sun_direction")
"""The ends of keys of parameters that are places."""


def shaded(name: str) -> Callable[[], Node]:
    return stage(
        "lamp", fill=LIGHTS["sky"]()["light"], body=lambda: {**SHAPES["sphere"](), "bsdf": materials.bsdf(name)}
    )


def lit(name: str) -> Callable[[], Node]:
    return lambda: {"floor": FLOOR, "body": body("sphere", "diffuse")(), "light": emitters.entry(name)}


def filled(name: str) -> Callable[[], Node]:
    ball = lambda: {**SHAPES["sphere"](), "bsdf": {"type": "null"}, "interior": MEDIA[name]()}  # noqa: E731
    return stage("lamp", fill=LIGHTS["sky"]()["light"], body=ball)


THIN: Node = {
    "type": "homogeneous",
    "albedo": {"type": "rgb", "value": [0.8, 0.6, 0.4]},
    "sigma_t": 1.5,
    "phase": {"type": "hg", "g": 0.4},
}
MEDIA: dict[str, Callable[[], Node]] = {
    "homogeneous": lambda: THIN,
    "heterogeneous": lambda: {
        "type": "heterogeneous",
        "albedo": 0.7,
        "sigma_t": {
            "type": "gridvolume",
            "grid": djpt.VolumeGrid(0.2 + 0.8 * np.random.default_rng(0).random((4, 4, 4, 1), np.float32)),
            "to_world": T().translate([-0.6, -0.7, -0.4]).scale(1.6),
        },
        "scale": 2.0,
    },
}


def first_of(kit: Any) -> list[str]:
    """The first parameter set of each plugin."""
    return list({kit.plugin_of(name): name for name in reversed(kit.NAMES)}.values())


def differentiable(nodes: Callable[[], Node], start: str) -> list[str]:
    """The keys of a scene's parameters that have derivatives and aren't places."""
    params = djpt.traverse(djpt.load_dict({"type": "scene", "sensor": camera_above(), **nodes()}, optimize=False))
    keys = (key for key in params if key.startswith(start) and params.flags(key).differentiable)
    return [key for key in keys if not key.endswith(PLACES)]


MUCH: dict[str, Any] = {"spp": 16384, "seeds": 2 * MOST_SEEDS}
BY_RESIDUAL: dict[str, Any] = {"picture": 0.3}
WITHIN: dict[str, Any] = {
    "spp": 0,
    "spp_difference": 8192,
    "settings": {**GUIDE, "sppc": 131072, "sppp": 64, "sppi": 8192},
}
"""Most samples within surfaces, where they take little time, and have most of the noise of smooth plastic."""
EFFORTS: dict[str, dict[str, Any]] = {
    "a camera in media: fog, turn, prbvolpath": BY_RESIDUAL,
    "a camera in media: fog, x_fov, prbvolpath": BY_RESIDUAL,
    "a camera in media: fog, a lens, x_fov, volpath": BY_RESIDUAL,
    "a material that moves: rough metal, sphere, sky, prb_projective": MUCH,
    "a material that moves: brushed metal, sphere, lamp, direct_projective": MUCH,
    "a material that moves: brushed metal, mesh, map, direct_projective": MUCH,
    "a material that moves: brushed metal, sphere, sky, prb_projective": MUCH,
    "a material that moves: mirror, sphere, lamp, direct_projective": MUCH,
    "a material that moves: glass, sphere, sky, prb_projective": MUCH,
    "a material that moves: plastic, sphere, sky, prb_projective": WITHIN,
    "a light that moves: a lamp, cylinder, direct_projective": MUCH,
    "a light that moves: a lamp, cylinder, prb_projective": MUCH,
    "a light that moves: a lamp, mesh, prb_projective": MUCH,
    "a light: sunsky-large sun, turbidity, prb": {**MUCH, "spp": 32768},
}
"""More samples and seeds for derivatives with much noise, or weights by which less cancels."""


def all_cells() -> dict[str, Cell]:
    """All cells by label."""
    shapes = (moving_shapes, moving_surfaces, meeting_shapes, moving_receivers)
    cameras_of_all = (cameras, cameras_over_fields, cameras_of_scenes, cameras_in_media)
    parts = (*shapes, moving_lights, *cameras_of_all, parameters)
    found = {cell.label: cell for part in parts for cell in part()}
    return found | {label: replace(found[label], **effort) for label, effort in EFFORTS.items()}


CELLS = all_cells()
