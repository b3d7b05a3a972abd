"""Groups of shapes and their instances: names, extents, errors; surface points and pixels as Mitsuba has them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from djpt.geometry.bvh.leaves import Extent, MeshPart
from djpt.geometry.two_level_bvh import Contents
from djpt.jit.types import Point3f, Vector3f
from djpt.shapes import Instance, ShapeGroup
from djpt.shapes.axes import AxisPool
from djpt.validation import agreement
from tests.kit.arrays import in_numpy, rows
from tests.kit.axes import unit
from tests.kit.mesh_scenes import ball, ball_file, diffuse, gallery, sheet_file, uv_texture
from tests.kit.renders import pixels, theirs

SHEAR = T([[1, 0.5, 0, 0], [0, 1, 0, 0], [-0.3, 0, 1, 0], [0, 0, 0, 1]])
INNER = T().translate([0.3, 0.1, 0]).rotate(unit(0, 1, 1), 20).scale([0.8, 0.5, -0.6])

SIMILAR = {
    "plain": T(),
    "turned": T().translate([1, 2, 0]).rotate(unit(1, 2, 3), 50),
    "small": T().translate([0, 1, 0]).scale(0.3),
    "turned and small": T().rotate(unit(3, 0, 1), 200).scale(0.5),
}
AFFINE = {
    **SIMILAR,
    "mirrored": T().translate([1, 0, 0]).scale([-1, 1, 1]),
    "stretched": T().rotate(unit(1, 0, 1), 30).scale([2, 0.5, 1]),
    "sheared": SHEAR @ T().rotate(unit(1, 0, 1), 30),
    "all of it": SHEAR @ T().translate([1, 2, 3]).scale([-2, 0.5, 1]).rotate(unit(1, 2, 1), 33),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("meshes")


# ---------------------------------------------------------------- descriptions

GROUP: dict[str, Any] = {
    "type": "shapegroup",
    "a": {"type": "cube", "to_world": T().translate([1, 0, 0])},
    "b": {"type": "sphere", "center": [0, 3, 0]},
}


def test_an_instance_reaches_as_far_as_its_moved_group() -> None:
    turned = T().translate([5, 0, 1]).rotate([0, 0, 1], 90).scale([2, 1, 1])
    instance = djpt.load_dict(
        {"type": "instance", "to_world": turned, "group": {"type": "shapegroup", "a": GROUP["a"]}}
    )
    assert isinstance(instance, Instance)
    assert isinstance(instance.group, ShapeGroup)
    instance.group.place(AxisPool())
    # x in [0, 2] becomes y in [0, 4]; y in [-1, 1] becomes x in [4, 6].
    extents = [instance.interval(axis) for axis in np.eye(3)]
    np.testing.assert_allclose(extents, [(4, 6), (0, 4), (0, 2)], atol=1e-6)
    group = djpt.load_dict(GROUP)
    group.place(AxisPool())
    assert group.interval(np.array([0.0, 1.0, 0.0])) == pytest.approx((-1, 4))


def test_parameters_have_the_names_of_mitsuba(mi: Any) -> None:
    names = [key for key, _ in mi.traverse(mi.load_dict({**GROUP, "a": {"type": "cube"}})).items()]
    # Mitsuba shows the BSDF that a shape without one gets.
    assert list(djpt.traverse(djpt.load_dict(GROUP))) == [n for n in names if ".bsdf." not in n]
    group = djpt.load_dict(GROUP)
    group.place(AxisPool())
    instance = djpt.load_dict({"type": "instance", "group": group})
    params = djpt.traverse(instance)
    assert list(params) == ["to_world"]
    params["to_world"] = T().translate([0, 0, 7])
    params.update()
    assert instance.interval(np.array([0.0, 0.0, 1.0])) == pytest.approx((6, 8))


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"type": "shapegroup"}, "shapegroup: the 'shapegroup' is empty"),
        ({"type": "shapegroup", "g": GROUP}, "'g' is itself a group or an instance"),
        ({"type": "shapegroup", "i": {"type": "instance", "g": GROUP}}, "'i' is itself a group or an instance"),
        (
            {"type": "shapegroup", "lamp": {"type": "sphere", "emitter": {"type": "area"}}},
            "'lamp' has an emitter; instanced shapes can't emit light",
        ),
        ({"type": "shapegroup", "x": GROUP["a"], "to_world": T()}, "unknown key 'to_world' of shape 'shapegroup'"),
        ({"type": "instance"}, "instance: an 'instance' needs one 'shapegroup' or a reference to one, found: none"),
        ({"type": "instance", "s": {"type": "sphere"}}, r"found: 's' \(Sphere\)"),
        ({"type": "instance", "g": GROUP, "h": GROUP}, r"found: 'g' \(ShapeGroup\), 'h' \(ShapeGroup\)"),
        ({"type": "instance", "g": GROUP, "bsdf": {"type": "diffuse"}}, "unknown key 'bsdf'"),
        ({"type": "instance", "g": GROUP, "to_world": T().scale(0).matrix}, "'to_world' must be invertible"),
    ],
)
def test_what_cannot_be_instanced_is_explained(node: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(node)


# ---------------------------------------------------------------- surface points


def meshes(folder: Path) -> dict[str, Any]:
    ball = ball_file(folder)
    return {
        "smooth": {"type": "ply", "filename": ball, "to_world": INNER},
        "flat": {"type": "ply", "filename": ball, "face_normals": True, "to_world": INNER},
        "no uv": {"type": "ply", "filename": ball_file(folder, 8, uv=False), "to_world": INNER},
        "flipped": {"type": "ply", "filename": sheet_file(folder), "flip_normals": True},
    }


SHAPES: dict[str, dict[str, Any]] = {
    "rectangle": {"type": "rectangle", "to_world": INNER},
    "cube": {"type": "cube", "to_world": INNER},
    "sphere": {"type": "sphere", "center": [0.2, 0, 0], "radius": 0.7},
    "turned sphere": {
        "type": "sphere",
        "to_world": T().translate([0.1, 0.2, 0.3]).rotate(unit(1, 1, 0), 40).scale(0.6),
    },
    "disk": {"type": "disk", "to_world": T().rotate(unit(1, 1, 0), 40).scale(0.8)},
    "cylinder": {"type": "cylinder", "radius": 0.5, "p0": [0, -0.5, 0], "p1": [0.2, 0.6, 0]},
}
SHEARABLE = ("rectangle", "cube", "disk")


def row_of(shape: dict[str, Any], places: dict[str, T]) -> dict[str, Any]:
    """One instance per place, side by side."""
    scene: dict[str, Any] = {"type": "scene", "g": {"type": "shapegroup", "s": shape}, "sky": {"type": "constant"}}
    for i, place in enumerate(places.values()):
        moved = T().translate([8 * i, 0, 0]) @ place
        scene[f"i{i}"] = {"type": "instance", "to_world": moved, "r": {"type": "ref", "id": "g"}}
    return scene


def rays_at(scene: dict[str, Any], count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays (3, N) towards all instances."""
    rng = np.random.default_rng(seed)
    origins, directions = [], []
    for node in scene.values():
        if isinstance(node, dict) and node["type"] == "instance":
            p = node["to_world"].matrix @ np.vstack([rng.uniform(-0.6, 0.6, (3, count)), np.ones(count)])
            d = rng.normal(size=(3, count))
            d /= np.linalg.norm(d, axis=0)
            origins.append(p[:3] - 2.5 * d)
            directions.append(d)
    return np.hstack(origins).astype(np.float32), np.hstack(directions).astype(np.float32)


FIELDS = ("t", "p", "n", "uv", "dp_du", "dp_dv", "sh_frame.s", "sh_frame.t", "sh_frame.n", "wi")


def compare(mi: Any, scene: dict[str, Any], tolerance: float, fields: tuple[str, ...] = FIELDS) -> None:
    """Equal surface points, but for rays that graze an edge."""
    o, d = rays_at(scene, 1000)
    ray = Ray3f(Point3f(*rows(o)), Vector3f(*rows(d)))
    a = djpt.load_dict(scene).ray_intersect(ray)
    reference = mi.load_dict(djpt.validation.to_mitsuba(scene), optimize=False)
    b = reference.ray_intersect(mi.Ray3f(mi.Point3f(ray.o), mi.Vector3f(ray.d)))
    dr.eval(a)
    dr.eval(b)
    hit, expected = np.array(a.is_valid()), np.array(b.is_valid())
    assert 0.2 < expected.mean() < 1
    assert np.mean(hit != expected) < 1e-3
    both = hit & expected
    for name in fields:
        x, y = a, b
        for part in name.split("."):
            x, y = getattr(x, part), getattr(y, part)
        x, y = (np.atleast_2d(in_numpy(v))[:, both] for v in (x, y))
        error = np.abs(x - y).max(axis=0) / np.maximum(1, np.abs(y).max(axis=0))
        assert np.mean(error > tolerance) < 2e-3, (name, np.quantile(error, [0.5, 0.9, 0.99]))
    np.testing.assert_array_equal(np.array(a.shape_index)[~hit], 0)


@pytest.mark.parametrize("kind", ["smooth", "flat", "no uv", "flipped"])
@pytest.mark.sparse(2)
def test_surface_points_on_meshes(mi: Any, folder: Path, kind: str) -> None:
    compare(mi, row_of(meshes(folder)[kind], AFFINE), 5e-4)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("kind", SHAPES)
def test_surface_points_on_analytic_shapes(mi: Any, kind: str) -> None:
    """Mitsuba computes these in the group's space, with larger errors where the instance is small."""
    places = dict(AFFINE) if kind in SHEARABLE else dict(SIMILAR)
    # A mirrored copy is a mirrored shape, whose geometric normal has the other sign.
    fields = tuple(name for name in FIELDS if name != "n") if kind in SHEARABLE else FIELDS
    compare(mi, row_of(SHAPES[kind], places), 3e-3, fields)


def test_what_a_shape_cannot_be_is_explained() -> None:
    with pytest.raises(SceneError, match=r"i0: g\.s\.to_world: .* sphere may only scale uniformly"):
        djpt.load_dict(row_of(SHAPES["sphere"], {"stretched": AFFINE["stretched"]}))


def test_many_shapes_in_a_group(mi: Any, folder: Path) -> None:
    """All kinds at once, in all places; of the meshes one, since a ray may hit any of those that coincide."""
    scene = row_of(SHAPES["cube"], SIMILAR)
    for i, shape in enumerate([meshes(folder)["smooth"], *SHAPES.values()]):
        scene["g"][f"s{i}"] = shape
    compare(mi, scene, 3e-3, ("t", "p", "sh_frame.n", "uv"))


@pytest.mark.parametrize("distance", [0.0, 300.0])
def test_a_small_instance_in_a_large_scene(folder: Path, distance: float) -> None:
    """Against a mesh that stands there outright."""
    place = T().translate([distance, 1, -2]).rotate(unit(1, 2, 3), 40).scale(1e-3)
    ball = {"type": "ply", "filename": ball_file(folder)}
    wall = {"type": "ply", "filename": sheet_file(folder), "to_world": T().translate([0, 0, -50]).scale(500)}
    group = {"type": "shapegroup", "b": ball}
    instance = {"type": "instance", "to_world": place, "r": {"type": "ref", "id": "g"}}
    one = djpt.load_dict({"type": "scene", "wall": wall, "g": group, "i": instance})
    other = djpt.load_dict({"type": "scene", "wall": wall, "b": {**ball, "to_world": place}})
    rng = np.random.default_rng(3)
    target = place.matrix @ np.vstack([rng.uniform(-0.6, 0.6, (3, 4000)), np.ones(4000)])
    o = (target[:3] + np.array([[0], [1], [3]]) + rng.normal(size=(3, 4000))).astype(np.float32)
    d = (target[:3] - o).astype(np.float32)
    a, b = (scene.ray_intersect(Ray3f(Point3f(o), Vector3f(d))) for scene in (one, other))
    t, expected = np.array(a.t), np.array(b.t)
    assert np.mean(np.abs(expected - 1) < 1e-2) > 0.8
    assert np.mean(np.abs(t - expected) > 2e-5 * np.abs(expected)) < 5e-3


# ---------------------------------------------------------------- images


def village(folder: Path, **keys: Any) -> dict[str, Any]:
    """The gallery with instances of a group of everything in it."""
    scene = gallery(folder, **keys)
    for name in ("smooth", "mirrored"):
        del scene[name]
    all_meshes = meshes(folder)
    scene["group"] = {
        "type": "shapegroup",
        "ball": {**all_meshes["smooth"], "bsdf": diffuse(0.7, 0.5, 0.2)},
        "sheet": {**all_meshes["flipped"], "bsdf": {"type": "twosided", "inner": diffuse(0.2, 0.7, 0.5)}},
        "cube": {"type": "cube", "to_world": T().translate([0, 1, 0]).rotate(unit(1, 0, 1), 20).scale(0.3)},
        "sphere": {"type": "sphere", "center": [0.8, 0.8, 0], "radius": 0.3, "bsdf": diffuse(0.1, 0.2, 0.9)},
    }
    places = (
        T().translate([-1.2, -0.2, 0.2]).rotate([0, 1, 0], 40).scale(0.6),
        T().translate([0.2, -0.3, 1.2]).rotate(unit(1, 1, 0), 100).scale(0.3),
        T().translate([1.1, 0.6, -0.4]).rotate(unit(1, 1, 1), -70).scale(0.4),
    )
    for i, place in enumerate(places):
        scene[f"i{i}"] = {"type": "instance", "to_world": place, "r": {"type": "ref", "id": "group"}}
    return scene


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_images(folder: Path, rfilter: str) -> None:
    pytest.importorskip("mitsuba")
    description = village(folder, size=(37, 30), rfilter=rfilter)
    scene = djpt.load_dict(description, optimize=False)
    machine, flat, wave = (pixels(djpt.render(scene, spp=8, seed=1, schedule=s)) for s in ("machine", "flat", "wave"))
    share = 0.97 if rfilter == "gaussian" else 0.99
    assert agreement(machine, flat, 1e-4).share > share
    assert agreement(machine, wave, 1e-4).share > share
    reference = theirs(description, 8, 1)
    assert agreement(machine, reference, 1e-3).share > share - 0.01
    assert machine.mean() == pytest.approx(reference.mean(), rel=2e-3)


def test_stretched_instances_of_meshes(folder: Path) -> None:
    pytest.importorskip("mitsuba")
    description = village(folder)
    del description["group"]["sphere"], description["group"]["cube"]
    description["i0"]["to_world"] = T().translate([-1, 0.2, 0]) @ SHEAR @ T().scale([0.3, -0.6, 0.5])
    scene = djpt.load_dict(description, optimize=False)
    machine, flat = (pixels(djpt.render(scene, spp=8, seed=1, schedule=s)) for s in ("machine", "flat"))
    assert agreement(machine, flat, 1e-4).share > 0.99
    assert agreement(machine, theirs(description, 8, 1), 1e-3).share > 0.98


def test_uv_on_instances(folder: Path) -> None:
    """A material that looks at uv, on meshes within instances."""
    description = village(folder)
    uv_texture(description["group"], "ball", "sheet", "cube")
    scene = djpt.load_dict(description)
    machine, flat = (pixels(djpt.render(scene, spp=8, seed=1, schedule=s)) for s in ("machine", "flat"))
    assert agreement(machine, flat, 1e-4).share > 0.99
    plain = pixels(djpt.render(djpt.load_dict(village(folder)), spp=8, seed=1))
    assert agreement(machine, plain, 1e-2).share < 0.9


def test_instances_alone(folder: Path) -> None:
    """No triangle and no analytic shape in the world itself; the group is seen only where it's placed."""
    pytest.importorskip("mitsuba")
    description = village(folder, lights=("sky",))
    for name in ("floor", "flat", "flipped", "ball", "block"):
        del description[name]
    del description["group"]["cube"], description["group"]["sphere"]
    image = pixels(djpt.render(djpt.load_dict(description, optimize=False), spp=8, seed=1))
    assert agreement(image, theirs(description, 8, 1), 1e-3).share > 0.98
    for name in ("i0", "i1", "i2"):
        del description[name]
    empty = pixels(djpt.render(djpt.load_dict(description), spp=1))
    np.testing.assert_allclose(empty, np.broadcast_to(empty[0, 0], empty.shape))


def test_gradients_reach_the_materials_of_groups(folder: Path) -> None:
    """One material, seen through all instances: path replay in both schedules, and finite differences."""
    prb = {"type": "prb", "max_depth": 4, "rr_depth": 1000}
    scene = djpt.load_dict(village(folder, size=(21, 18), integrator=prb))
    params, name = djpt.traverse(scene), "group.ball.bsdf.reflectance.value"
    value = np.array(params[name]).ravel()
    found = {}
    for schedule in ("machine", "flat"):
        options = {"spp": 8, "seed": 3, "seed_grad": 3, "schedule": schedule}
        params[name] = djpt.Color3f(*value.tolist())
        dr.enable_grad(params[name])
        params.update()
        dr.backward(dr.sum(djpt.render(scene, params, **options).array))
        found[schedule] = np.array(dr.grad(params[name])).ravel()
        sums = []
        for h in (0.02, -0.02):
            params[name] = djpt.Color3f(*(value + np.array([h, 0, 0])).tolist())
            params.update()
            sums.append(pixels(djpt.render(scene, **options)).astype(np.float64).sum())
        assert found[schedule][0] == pytest.approx((sums[0] - sums[1]) / 0.04, rel=5e-3)
    np.testing.assert_allclose(found["machine"], found["flat"], rtol=3e-3)


# ---------------------------------------------------------------- many


def test_a_thousand_instances(folder: Path) -> None:
    """They cost a record each; a mesh among them is kept once."""
    rng = np.random.default_rng(0)
    scene: dict[str, Any] = {
        "type": "scene",
        "g": {"type": "shapegroup", "s": {"type": "ply", "filename": ball_file(folder, 40)}},
        "sky": {"type": "constant"},
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective",
            "to_world": T().look_at([0, 0, 12], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
        },
    }
    for i in range(1000):
        place = T().translate(rng.uniform(-4, 4, 3).tolist()).rotate(unit(*rng.normal(size=3)), 90.0).scale(0.2)
        scene[f"i{i}"] = {"type": "instance", "to_world": place, "r": {"type": "ref", "id": "g"}}
    djpt.load_dict({**scene, "i0": scene["i1"]})
    start = time.process_time()
    loaded = djpt.load_dict(scene)
    assert time.process_time() - start < 3
    triangles = loaded.geometry.triangles
    assert triangles is not None
    assert triangles.tree.bytes < 128 * (triangles.meshes.face_count + 1000)
    machine, wave = (pixels(djpt.render(loaded, spp=4, schedule=s)) for s in ("machine", "wave"))
    assert agreement(machine, wave, 1e-4).share > 0.99


@pytest.mark.parametrize("name", AFFINE)
def test_boxes_of_instances_are_tight(name: str) -> None:
    data = ball(24)
    positions, faces = data["positions"], data["faces"]
    # A vertex without a face doesn't count, nor does one that isn't a number.
    mesh = djpt.Mesh("ball", np.concatenate([positions, [[9, 9, 9], [np.nan, 0, 0]]]), faces)
    extent = Extent(*(find(positions.astype(np.float32), axis=0) for find in (np.min, np.max)))
    to_world = AFFINE[name].matrix
    low, high = Contents.of(MeshPart([mesh], np.zeros(1, np.uint32), 0), extent).placed_box(to_world)
    # The box about the turned box about a ball is up to 1.7 times as wide as it need be.
    placed = positions.astype(np.float32) @ to_world[:3, :3].T + to_world[:3, 3]
    assert (low <= placed.min(axis=0)).all()
    assert (placed.max(axis=0) <= high).all()
    assert (high - low <= 1.15 * np.ptp(placed, axis=0)).all()
