"""Every plugin of djpt's moves into a working frame as the map p -> scale (p - center) says, or refuses on purpose."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.description.plugin import NotMovable
from djpt.jit.types import Float, Point2f, Point3f, TensorXf, Vector3f
from djpt.scene.normalization.normalized_scene import WorkingFrame
from djpt.scene.normalization.plugin_copies import PluginCopies
from djpt.shapes.axes import AxisPool
from tests.kit.emitters import SETS, entry
from tests.kit.meshes import tetrahedron_file, write_serialized
from tests.kit.plugins import SHEARED

SCALE, CENTER = 2.0**-3, (1.0, -2.0, 0.5)
PLACED = SHEARED @ T().translate([1, 2, 3])
RIGID = T().translate([1, 2, 3]).rotate([0.6, -0.48, 0.64], 40)


def copies() -> PluginCopies:
    return PluginCopies(WorkingFrame(SCALE, CENTER))


def in_frame(p: Any) -> Any:
    return SCALE * (np.array(p) - np.array(CENTER))


def own(kind: str) -> list[str]:
    return [name for name, factory in registry.registered(kind).items() if registry.is_own(factory)]


def at(p: Any) -> MediumInteraction3f:
    """A point in space, seen by a ray along z."""
    return MediumInteraction3f.on(Ray3f(Point3f(*np.asarray(p, float).tolist()), Vector3f(0, 0, 1)), Float(0))


@pytest.mark.parametrize("kind", ["bsdf", "texture", "phase", "emitter", "shape", "sensor", "medium", "volume"])
def test_every_class_says_how_it_moves(kind: str) -> None:
    factories: list[Any] = [registry.lookup(kind, name) for name in own(kind)]
    classes = [each for each in factories if isinstance(each, type)]
    assert classes and all("move_into" in vars(each) or each.__dict__.get("in_any_frame") for each in classes)


def both(plugin: Any) -> tuple[Any, Any]:
    return plugin, copies().copy_of(plugin)


# ---- shapes ------------------------------------------------------------------------------------


def written(name: str, folder: Path) -> dict[str, Any]:
    """The entries of a shape that reads a file."""
    corners, faces = np.eye(4, 3), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    if name == "ply":
        return {"filename": tetrahedron_file()}
    path = folder / f"shape.{name}"
    if name == "obj":
        path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    elif name == "serialized":
        write_serialized(path, [{"positions": corners, "faces": faces}])
    else:
        path.write_text("\n".join(f"{k} {k % 2} {0.3 * k} 0.1" for k in range(5)))
    return {"filename": str(path)}


INNER = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.5}}
CLOUD = {"data": TensorXf(np.array([[1, 2, 3, 0.1, 0.2, 0.3, 0, 0, 0, 1]], np.float32))}
BLOCK = np.linalg.norm(np.indices((4, 4, 4)) - 1.5, axis=0)[..., None] - 1
SHAPES: dict[str, dict[str, Any] | Callable[[str, Path], dict[str, Any]]] = {
    "sphere": {"center": [1, 2, 3], "to_world": RIGID.scale(2)},
    "cylinder": {"p0": [-1, 0.5, 2], "p1": [1, 0.2, 1.5], "radius": 0.4},
    "cone": {"apex": [0.5, 0.2, 1.2], "axis": [0, 1, 1], "angle": 30},
    "paraboloid": {"vertex": [0.5, 0.2, 2.5], "axis": [0, 1, -1], "focal_length": 0.3},
    "cuboid": {"min": [-1, 0.2, 2], "max": [0.5, 0.4, 3]},
    "implicit": {"function": lambda p: dr.norm(p) - 0.7, "to_world": PLACED},
    "metaballs": {"balls": [[-0.5, 0, 2, 0.8], [0.3, 0.2, 2.2, 0.7]]},
    "sdfgrid": {"grid": TensorXf(BLOCK.astype(np.float32)), "to_world": PLACED},
    "instance": {"group": INNER, "to_world": RIGID.scale(2)},
    "shapegroup": {"ball": {"type": "sphere"}},
    "deforming": {f"at {k}": {"type": "ply", "filename": tetrahedron_file()} for k in range(2)} | {"to_world": PLACED},
    "ellipsoids": CLOUD,
    "ellipsoidsmesh": CLOUD,
    **dict.fromkeys(("ply", "obj", "serialized", "linearcurve", "bsplinecurve"), written),
}
"""The entries of shapes that need some; others are placed by `to_world` alone."""
PARTS = ("merge", "shapegroup")
"""Shapes that have no place: those that become others when they are loaded, and groups, which are seen by instances."""


@pytest.mark.parametrize("name", own("shape"))
def test_shapes_move(name: str, tmp_path: Path) -> None:
    if name in PARTS:
        return
    keys = SHAPES.get(name, {"to_world": PLACED})
    shape = djpt.load_dict({"type": name, **(keys(name, tmp_path) if callable(keys) else keys)})
    before, after = both(shape)
    for placed in (before, after):
        placed.place(AxisPool())
        if name == "instance":
            placed.group.place(AxisPool())
    for direction in (*np.eye(3), np.array([0.6, -0.48, 0.64])):
        expected = [SCALE * (x - direction @ CENTER) for x in before.interval(direction)]
        np.testing.assert_allclose(after.interval(direction), expected, rtol=1e-5, atol=1e-5)


def test_groups_keep_their_space() -> None:
    before, after = both(djpt.load_dict({"type": "shapegroup", "ball": {"type": "sphere"}}))
    assert after.shapes[0] is not before.shapes[0]
    assert after.shapes[0].to_world == before.shapes[0].to_world


# ---- lights ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", own("emitter"))
def test_lights_move(name: str) -> None:
    """The same light arrives at a point, from the same direction."""
    given = entry(f"{name}-{next(iter(SETS[name]))}") if name in SETS else {"type": name}
    plugin = djpt.load_dict({"type": "scene", "light": given}).emitters()[0]
    before, after = both(plugin)
    assert (after.shape is None) == (before.shape is None)
    found = []
    for emitter, p in ((before, (0.3, 0.2, 0.1)), (after, in_frame((0.3, 0.2, 0.1)))):
        if emitter.shape is not None:
            emitter.shape.place(AxisPool())
        ds, weight = emitter.sample_direction(at(p), Point2f(0.4, 0.7))
        found.append(np.concatenate([np.array(ds.d).ravel(), np.array(weight).ravel()]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-4, atol=1e-6)


# ---- sensors -----------------------------------------------------------------------------------

BOX = {"film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}}
STANDING = {"to_world": RIGID}
SENSORS: dict[str, dict[str, Any]] = {
    "perspective": STANDING | {"near_clip": 0.1, "far_clip": 50},
    "thinlens": STANDING | {"aperture_radius": 0.1, "focus_distance": 3.0},
    "orthographic": {"to_world": RIGID.scale([2, 2, 1])},
    "fisheye": STANDING | {"fov": 120.0, "near_clip": 0.1, "far_clip": 50},
    "panorama": STANDING | {"eye": "left", "eye_distance": 0.4, "near_clip": 0.1, "far_clip": 50},
    "radiancemeter": STANDING,
    "distant": {"direction": [0.1, 0.2, -1], "target": [1, 2, 3]},
    "irradiancemeter": {},
    "batch": {"one": {"type": "perspective", **STANDING}, "two": {"type": "radiancemeter", **STANDING}},
}


LENSES: dict[str, dict[str, Any]] = {
    "tilted lens": {**SENSORS["thinlens"], "type": "thinlens", "tilt": 30, "aperture_blades": 5},
    "distorting lens": {**SENSORS["perspective"], "type": "perspective", "k1": -0.1},
}


@pytest.mark.parametrize("name", [*own("sensor"), *LENSES])
def test_sensors_move(name: str) -> None:
    """Rays start at the point in the frame of their starts, in the same directions."""
    sensor = LENSES[name] if name in LENSES else {"type": name, **SENSORS[name]}
    if name == "irradiancemeter":
        plugin = djpt.load_dict({"type": "rectangle", "to_world": RIGID, "sensor": sensor | BOX}).sensor()
    else:
        plugin = djpt.load_dict(sensor)
    before, after = both(plugin)
    if after.shape is not None:
        after.shape.place(AxisPool())
    before.set_bounds(np.zeros(3), 10.0)
    after.set_bounds(in_frame(np.zeros(3)), SCALE * 10.0)
    rays = [s.ray_through(Point2f(0.3, 0.6), Point2f(0.2, 0.9)) for s in (before, after)]
    starts = [np.array(ray.o).ravel() for ray in rays]
    # Meters move rays off by a constant, about 1e-4.
    np.testing.assert_allclose(starts[1], in_frame(starts[0]), atol=2e-4)
    np.testing.assert_allclose(*(np.array(ray.d).ravel() for ray in rays), atol=1e-6)
    assert float(rays[1].maxt[0]) == pytest.approx(SCALE * float(rays[0].maxt[0]), rel=1e-5)


# ---- matter ------------------------------------------------------------------------------------

GRID = {
    "type": "gridvolume",
    "data": np.random.default_rng(1).random((4, 5, 6, 1)).astype(np.float32),
    "to_world": PLACED,
}
MEDIA: dict[str, dict[str, Any]] = {
    "homogeneous": {"sigma_t": 0.7, "albedo": 0.4, "emission": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
    "heterogeneous": {"sigma_t": GRID, "albedo": GRID, "emission": GRID, "scale": 3.0},
}
VOLUMES: dict[str, dict[str, Any]] = {"constvolume": {"value": 0.3}, "gridvolume": GRID}
INSIDE = PLACED.matrix[:3] @ np.array([0.3, 0.6, 0.4, 1])


@pytest.mark.parametrize("name", own("medium"))
def test_media_move(name: str) -> None:
    """Albedos stay, and what is per unit of length goes with the inverse of the scale."""
    before, after = both(djpt.load_dict({"type": name, **MEDIA[name]}))
    found = []
    for medium, p, unit in ((before, INSIDE, 1.0), (after, in_frame(INSIDE), SCALE)):
        coefficients = medium.get_scattering_coefficients(at(p))
        per_length = [*coefficients, medium.get_majorant(at(p)), medium.emission_at(at(p))]
        found.append(np.array([np.array(c).ravel() * unit for c in per_length]))
        assert medium.emission_at(at(p)).x[0] > 0
    np.testing.assert_allclose(found[1], found[0], rtol=1e-4)
    spans = [np.array([float(x[0]) for x in m.intersect_aabb(Ray3f(Point3f(*p.tolist()), Vector3f(0, 0, 1)))[1:]])
             for m, p in ((before, INSIDE), (after, in_frame(INSIDE)))]  # fmt: skip
    np.testing.assert_allclose(spans[1], SCALE * spans[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", own("volume"))
def test_volumes_move(name: str) -> None:
    before, after = both(djpt.load_dict({"type": name, **VOLUMES[name]}))
    assert (after is before) == before.is_constant
    assert float(after.eval_1(at(in_frame(INSIDE)))[0]) == pytest.approx(float(before.eval_1(at(INSIDE))[0]), rel=1e-4)


# ---- materials ---------------------------------------------------------------------------------


def test_materials_without_lengths_are_shared() -> None:
    height = {"type": "checkerboard"}
    bumpy = {"type": "bumpmap", "height": height, "b": {"type": "diffuse"}}
    glass = {"type": "dielectric", "absorption": 0.5}
    for description in ({"type": "plastic"}, {"type": "twosided", "b": {"type": "diffuse"}}, {"type": "dielectric"}):
        before, after = both(djpt.load_dict(description))
        assert after is before
    for description in (bumpy, glass, {"type": "mask", "b": bumpy}, {"type": "blendbsdf", "a": glass, "b": glass}):
        plugin = djpt.load_dict(description)
        assert copies().copy_of(plugin) is not plugin
        assert PluginCopies(WorkingFrame(1.0, CENTER)).copy_of(plugin) is plugin


# ---- plugins that say nothing ------------------------------------------------------------------


class Lamp(djpt.Emitter):
    """A lamp whose class doesn't say how it moves."""


class MovingLamp(Lamp):
    """One that does."""

    def move_into(self, frame: Any) -> None:
        self.at = frame.point([1, 1, 1])


def test_classes_decide_for_themselves() -> None:
    for name, kind in (("test_frame_lamp", Lamp), ("test_frame_moving_lamp", MovingLamp)):
        djpt.register_emitter(name, kind)
    with pytest.raises(NotMovable, match=r"test_frame_lamp: 'Lamp' has no move_into of its own and isn't in_any_frame"):
        copies().copy_of(djpt.load_dict({"type": "test_frame_lamp"}))
    moved = copies().copy_of(djpt.load_dict({"type": "test_frame_moving_lamp"}))
    np.testing.assert_array_equal(moved.at, in_frame([1, 1, 1]))
