"""Edits of scenes with meshes and instances: the image of a scene loaded so, and no new kernel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError
from djpt.geometry.engines import ray_queries
from djpt.validation import agreement
from tests.kit.axes import unit
from tests.kit.kernels import kernels
from tests.kit.mesh_scenes import ball, ball_file, gallery
from tests.kit.meshes import write_binary_ply
from tests.kit.renders import pixels

NEAR = T().look_at(origin=[0.3, 1.2, 4.5], target=[0, 0.1, 0], up=[0, 1, 0])
FAR = T().look_at(origin=[300, 1200, 4500], target=[0, 0.1, 0], up=[0, 1, 0])
PRB = {"type": "prb", "max_depth": 4, "rr_depth": 1000}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("meshes")


def village(folder: Path, **keys: Any) -> dict[str, Any]:
    """Meshes whose normals come from their vertices, a lamp that is one, and two instances."""
    scene = gallery(folder, (24, 20), **keys)
    plain = ball_file(folder, 10, normals=False)
    scene["smooth"]["filename"] = plain
    del scene["mirrored"], scene["block"]
    group = {"type": "ply", "filename": plain, "face_normals": True, "to_world": T().scale([1, 0.6, 1])}
    cube = {"type": "cube", "to_world": T().translate([0, 1, 0]).rotate(unit(1, 0, 1), 20).scale(0.4)}
    scene["group"] = {"type": "shapegroup", "ball": group, "cube": cube}
    for i, x in enumerate((-0.4, 0.7)):
        place = T().translate([x, -0.6, 1.1]).rotate(unit(1, 1, i), 30 + 50 * i).scale(0.25)
        scene[f"i{i}"] = {"type": "instance", "to_world": place, "r": {"type": "ref", "id": "group"}}
    return scene


class Watched:
    """A scene that is edited, and the kernels that it has launched so far."""

    def __init__(self, description: dict[str, Any], gradients: tuple[str, ...] = (), **options: Any) -> None:
        self.scene = djpt.load_dict(description)
        self.params = djpt.traverse(self.scene)
        self.gradients, self.options = gradients, {"spp": 4, "seed": 2, **options}
        self.known: set[Any] = set()
        for _ in range(2):
            self.new()

    def new(self) -> int:
        """Render, and count kernels not seen before."""
        launched = kernels(self._render)
        count = len(launched - self.known)
        self.known |= launched
        return count

    def _render(self) -> None:
        for name in self.gradients:
            dr.enable_grad(self.params[name])
            self.params.set_dirty(name)
        self.params.update()
        image = djpt.render(self.scene, self.params, **self.options)
        if self.gradients:
            dr.clear_grad([self.params[name] for name in self.gradients])
            dr.backward(dr.sum(dr.square(image.array)))
        self.image = pixels(image)

    def edit(self, **values: Any) -> int:
        for name, value in values.items():
            self.params[name] = value
        # What the edit itself computes, tables and trees, isn't meant here.
        self.params.update()
        return self.new()

    def move(self, mesh: str, motion: T) -> int:
        """Apply a motion to all vertices of a mesh."""
        name = f"{mesh}.vertex_positions"
        p = np.array(self.params[name], np.float64).reshape(-1, 3) @ motion.matrix[:3, :3].T + motion.matrix[:3, 3]
        return self.edit(**{name: p.ravel()})


def looks_like(image: np.ndarray, description: dict[str, Any], share: float = 0.99) -> None:
    """The edited scene shows what one loaded so would show."""
    wanted = pixels(djpt.render(djpt.load_dict(description), spp=4, seed=2))
    found = agreement(image, wanted, 1e-3)
    assert found.share >= share, found


Change = Callable[[dict[str, Any]], None]


def assign(*path: str, value: Any) -> Change:
    def change(scene: dict[str, Any]) -> None:
        node = scene
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value

    return change


def rgb(*color: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(color)}


COLOR, LIGHT = [0.1, 0.9, 0.4], [3.0, 2.0, 9.0]
VALUES: dict[str, tuple[Any, Change]] = {
    "flat.bsdf.reflectance.value": (COLOR, assign("flat", "bsdf", "reflectance", value=rgb(*COLOR))),
    "flipped.bsdf.brdf_0.reflectance.value": (COLOR,
        assign("flipped", "bsdf", "inner", "reflectance", value=rgb(*COLOR))),
    "lamp.emitter.radiance.value": (LIGHT, assign("lamp", "emitter", "radiance", value=rgb(*LIGHT))),
    "point.intensity.value": (LIGHT, assign("point", "intensity", value=rgb(*LIGHT))),
    "point.position": ([-1.0, 2.0, 2.0], assign("point", "position", value=[-1.0, 2.0, 2.0])),
    "sensor.to_world": (T().look_at([2, 1, 4], [0, 0, 0], [0, 1, 0]),
                        assign("sensor", "to_world", value=T().look_at([2, 1, 4], [0, 0, 0], [0, 1, 0]))),
    "sensor.x_fov": (30.0, assign("sensor", "fov", value=30.0)),
    "ball.to_world": (T().translate([0.5, 0.2, 0.6]).scale(0.3), None),
    "i0.to_world": (T().translate([0, 0.4, 1]).rotate(unit(0, 1, 2), 80).scale(0.3),
                    assign("i0", "to_world", value=T().translate([0, 0.4, 1]).rotate(unit(0, 1, 2), 80).scale(0.3))),
    "i1.to_world": (T().translate([0.9, 0.3, 1]).rotate(unit(2, 1, 2), -20).scale([0.3, -0.4, 0.2]),
                    assign("i1", "to_world",
                           value=T().translate([0.9, 0.3, 1]).rotate(unit(2, 1, 2), -20).scale([0.3, -0.4, 0.2]))),
}  # fmt: skip
"""Per parameter a value, and what makes a description say the same; None: a new centre and radius."""


@pytest.mark.parametrize("rfilter", ["box", pytest.param("gaussian", marks=pytest.mark.slow)])
def test_values_and_places(folder: Path, rfilter: str) -> None:
    """One after the other, each edit kept: the description follows."""
    description = village(folder, rfilter=rfilter)
    watched = Watched(description)
    new = {}
    for name, (value, change) in VALUES.items():
        new[name] = watched.edit(**{name: value})
        if change is not None:
            change(description)
        else:
            description["ball"].update(center=[0.5, 0.2, 0.6], radius=0.3)
        looks_like(watched.image, description, 0.97 if rfilter == "gaussian" else 0.99)
    # The cubes of the two instances start with common axes perhaps: that may end, once each.
    assert new.pop("i0.to_world") <= 1
    assert new.pop("i1.to_world") <= 1
    assert not any(new.values()), new
    assert watched.edit(**{"i0.to_world": T().translate([0.2, 0.3, 1]).rotate(unit(1, 1, 0), 10).scale(0.2)}) == 0


MOVES = {
    "shifted": T().translate([0.3, 0.4, 0.2]),
    "turned": T().rotate(unit(1, 2, 0), 70),
    "grown": T().scale([1.5, 1.4, 1.7]),
    "away": T().translate([0, 0, -30]),
}


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("flat", "flipped")]


@pytest.mark.parametrize("mesh", ["smooth", "lamp", *SLOW])
def test_vertices(folder: Path, mesh: str) -> None:
    description = village(folder)
    if mesh == "flipped":
        description[mesh]["face_normals"] = True
    watched = Watched(description)
    start, place = watched.image, description[mesh]["to_world"]
    original = np.array(watched.params[f"{mesh}.vertex_positions"])
    for name, motion in MOVES.items():
        assert watched.move(mesh, motion) == 0, name
        looks_like(watched.image, {**description, mesh: {**description[mesh], "to_world": motion @ place}})
        assert watched.edit(**{f"{mesh}.vertex_positions": original}) == 0
        assert agreement(watched.image, start, 1e-4).share > 0.995, name


def test_vertices_of_a_group(folder: Path) -> None:
    """All instances follow."""
    description = village(folder)
    watched = Watched(description)
    motion = T().translate([0.2, 0.3, 0]).rotate([1, 0, 0], 40).scale(1.3)
    assert watched.move("group.ball", motion) == 0
    inner = description["group"]["ball"]
    inner["to_world"] = motion @ inner["to_world"]
    looks_like(watched.image, description)
    color = {"type": "diffuse", "reflectance": rgb(*COLOR)}
    assert watched.edit(**{"group.ball.bsdf.reflectance.value": COLOR}) == 0
    inner["bsdf"] = color
    looks_like(watched.image, description)


def test_shapes_of_a_group(folder: Path) -> None:
    description = village(folder)
    watched = Watched(description)
    place = T().translate([0, 1.3, 0]).rotate(unit(1, 0, 1), 50).scale(0.3)
    corners = np.array(watched.params["group.cube.vertex_positions"], np.float64).reshape(-1, 3)
    motion = place @ description["group"]["cube"]["to_world"].inverse()
    moved = corners @ motion.matrix[:3, :3].T + motion.matrix[:3, 3]
    assert watched.edit(**{"group.cube.vertex_positions": moved.ravel()}) <= 1
    description["group"]["cube"]["to_world"] = place
    looks_like(watched.image, description)


@pytest.mark.slow
def test_wild_vertices(folder: Path) -> None:
    """Trees of very different shapes: the depth of those that are searched by steps is structure, and may only grow."""
    with ray_queries("steps"):
        watched = Watched(village(folder))
    original = np.array(watched.params["smooth.vertex_positions"]).reshape(-1, 3)
    rng = np.random.default_rng(0)
    wild = [
        rng.uniform(-1, 1, original.shape),
        original * 1e-3,
        original ** np.array([1, 3, 5]),
        np.sign(original) * 2.0 ** -rng.uniform(0, 30, original.shape),
        np.tile(original[:1], (len(original), 1)),
    ]
    deepest, total = 0, 0
    for positions in (*wild, *wild):
        before = watched.scene.geometry.triangles.tree.depth
        new = watched.edit(**{"smooth.vertex_positions": positions.astype(np.float32).ravel()})
        depth = watched.scene.geometry.triangles.tree.depth
        assert depth >= before
        assert new <= (depth > deepest > 0 or depth > before)
        deepest, total = max(deepest, depth), total + new
        assert np.isfinite(watched.image).all()
        flat, wave = (pixels(djpt.render(watched.scene, spp=4, seed=2, schedule=s)) for s in ("flat", "wave"))
        assert agreement(watched.image, flat, 1e-3).share > 0.98
        assert agreement(watched.image, wave, 1e-3).share > 0.98
    assert total <= 3
    assert watched.edit(**{"smooth.vertex_positions": original.ravel()}) == 0


def test_a_mesh_without_extent_is_as_good_as_none(folder: Path) -> None:
    description = village(folder)
    watched = Watched(description)
    for mesh in ("smooth", "lamp"):
        positions = np.array(watched.params[f"{mesh}.vertex_positions"])
        assert watched.edit(**{f"{mesh}.vertex_positions": np.ones_like(positions)}) == 0
        assert np.isfinite(watched.image).all()
        dark = {**description, "lamp": {**description["lamp"], "emitter": {"type": "area", "radiance": 0.0}}}
        dark["lamp"]["to_world"] = T().translate([0, 1000, 0])
        without = {**description} if mesh == "smooth" else dark
        without.pop(mesh) if mesh == "smooth" else None
        looks_like(watched.image, without, 0.98)
        watched.edit(**{f"{mesh}.vertex_positions": positions})


def test_fewer_triangles_and_back(folder: Path) -> None:
    description = village(folder)
    watched = Watched(description)
    start = watched.image
    faces = np.array(watched.params["flat.faces"])
    assert watched.edit(**{"flat.faces": faces[: len(faces) // 2]}) == 0
    data = ball(12)
    half = {**data, "faces": data["faces"][: len(data["faces"]) // 2]}
    path = write_binary_ply(folder / "half.ply", half)
    looks_like(watched.image, {**description, "flat": {**description["flat"], "filename": str(path)}})
    assert watched.edit(**{"flat.faces": faces}) == 0
    assert agreement(watched.image, start, 1e-4).share > 0.995


def test_bad_values_change_nothing(folder: Path) -> None:
    watched = Watched(village(folder))
    start = watched.image
    positions = np.array(watched.params["smooth.vertex_positions"])
    broken = positions.copy()
    broken[7] = np.nan
    bad = {
        "smooth.vertex_positions": [broken, positions[:-1], positions[:-3], np.inf * positions],
        "smooth.faces": [np.array([], np.uint32), np.array([0, 1, 10**6]), np.array([0, 1])],
        "i0.to_world": [np.zeros((4, 4)), T().scale([1, 0, 1]).matrix, "here"],
    }
    for name, values in bad.items():
        for value in values:
            with pytest.raises(ParameterError, match=name.split(".")[0]):
                watched.edit(**{name: value})
            assert watched.new() == 0
            np.testing.assert_array_equal(watched.image, start)


# ---------------------------------------------------------------- far away and back


@pytest.mark.parametrize("schedule", ["machine", "flat", "wave"])
@pytest.mark.sparse(4)
def test_a_camera_that_goes_far_away_and_comes_back(folder: Path, schedule: str) -> None:
    """From afar rays are moved near the triangles first: a new kernel, once."""
    description = village(folder)
    watched = Watched(description, schedule=schedule)
    start = watched.image
    assert watched.edit(**{"sensor.to_world": FAR, "sensor.x_fov": 0.05}) <= 1
    description["sensor"].update(to_world=FAR, fov=0.05)
    looks_like(watched.image, description, 0.97)
    assert watched.edit(**{"sensor.to_world": NEAR, "sensor.x_fov": 45.0}) == 0
    assert agreement(watched.image, start, 1e-3).share > 0.98
    assert watched.edit(**{"sensor.to_world": T().translate([0, 0, -20]) @ FAR, "sensor.x_fov": 0.05}) == 0


@pytest.mark.parametrize("schedule", ["machine", "flat"])
def test_meshes_from_afar(folder: Path, schedule: str) -> None:
    """From 10^4 sizes away hits are as precise as from nearby: else surfaces would shadow themselves."""
    means = []
    for distance in (1e3, 1e4):
        description = village(folder, integrator={"type": "path", "max_depth": 2}, lights=("sky",))
        for name in ("floor", "ball"):
            del description[name]
        del description["group"]["cube"]
        origin = (np.array([0.06, 0.25, 0.96]) * distance).tolist()
        description["sensor"].update(to_world=T().look_at(origin, [0, 0, 0], [0, 1, 0]), fov=200 / distance)
        image = djpt.render(djpt.load_dict(description), spp=64, seed=1, schedule=schedule)
        means.append(pixels(image).mean())
    assert means[0] == pytest.approx(means[1], rel=2e-3)


# ---------------------------------------------------------------- gradients


def test_gradients_after_moves(folder: Path) -> None:
    """The replay's kernels outlive edits as well, and differentiate the edited scene."""
    names = ("flat.bsdf.reflectance.value", "group.ball.bsdf.reflectance.value")
    description = village(folder, integrator=PRB)
    watched = Watched(description, names)
    motion = T().translate([0.2, 0.1, 0.3])
    assert watched.move("flat", motion) == 0
    place = T().translate([0, 0.2, 1.3]).rotate(unit(0, 1, 2), 10).scale(0.3)
    assert watched.edit(**{"i0.to_world": place}) <= 2
    place = T().translate([0, 0.3, 1.3]).rotate(unit(0, 1, 2), 20).scale(0.3)
    assert watched.edit(**{"i0.to_world": place}) == 0
    edited = [np.array(dr.grad(watched.params[name])) for name in names]
    description["flat"]["to_world"] = motion @ description["flat"]["to_world"]
    description["i0"]["to_world"] = place
    fresh = Watched(description, names)
    for name, gradient in zip(names, edited, strict=True):
        assert np.abs(gradient).min() > 0
        np.testing.assert_allclose(gradient, np.array(dr.grad(fresh.params[name])), rtol=5e-3)


def test_two_scenes_share_nothing(folder: Path) -> None:
    """Editing one scene leaves another, made of the same description, alone."""
    description = village(folder)
    one, other = Watched(description), Watched(description)
    start = other.image
    one.move("smooth", MOVES["grown"])
    one.edit(**{"i0.to_world": T().scale(0.5)})
    other.new()
    np.testing.assert_array_equal(other.image, start)
