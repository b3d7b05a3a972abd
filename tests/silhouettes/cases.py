"""What moves, and in which scene: cases of shapes whose derivatives central differences check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point3f, TensorXf, UInt32
from tests.silhouettes.test_projective import octahedron

SIZE = 16
COLUMN = np.linspace(-1, 1, SIZE, dtype=np.float32)
WEIGHTS = np.broadcast_to(np.sin(2 * COLUMN[None, :, None] + 1) + 0.5 * COLUMN[:, None, None], (SIZE, SIZE, 3)).copy()
"""The derivative of a loss by the pixels."""

Move = Callable[[Any, Float], None]


def shift(key: str, x: float = 1.0, y: float = 0.3, z: float = 0.0) -> Move:
    """Move by theta along a direction."""

    def move(params: Any, theta: Float) -> None:
        params[key] = djpt.Transform4f().translate([x * theta, y * theta, z * theta]) @ djpt.Transform4f(params[key])

    return move


def turn(key: str, degrees: float) -> Move:
    """Turn about the y axis of the world."""

    def move(params: Any, theta: Float) -> None:
        params[key] = djpt.Transform4f().rotate([0, 1, 0], degrees * theta) @ djpt.Transform4f(params[key])

    return move


def slide(params: Any, theta: Float) -> None:
    """Move the vertices of a mesh."""
    positions = Float(params["moving.vertex_positions"])
    x, y = (dr.arange(UInt32, dr.width(positions)) % 3 == axis for axis in (0, 1))
    params["moving.vertex_positions"] = positions + dr.select(x, theta, dr.select(y, 0.3 * theta, 0))


def edit(key: str, by: float) -> Move:
    """Add to a number."""

    def move(params: Any, theta: Float) -> None:
        params[key] = Float(params[key]) + by * theta

    return move


def turn_head(params: Any, theta: Float) -> None:
    """Turn the camera about an axis of its own."""
    own = djpt.Transform4f().rotate([0.6, 0.8, 0], 20 * theta)
    params["sensor.to_world"] = djpt.Transform4f(params["sensor.to_world"]) @ own


def sensor(origin: tuple[float, float, float] = (0, 0, 6), fov: float = 40, **more: Any) -> dict[str, Any]:
    """A camera above the origin, which looks down; or from elsewhere, towards the origin."""
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    place = T().look_at(list(origin), [0, 0, 0], [0, 1, 0])
    return {"type": "perspective", "fov": fov, "to_world": place, "film": film, **more}


def sky() -> dict[str, Any]:
    """A smooth environment."""
    row, column = np.arange(16)[:, None, None], np.arange(32)[None, :, None]
    radiance = 0.3 + np.abs(np.sin(0.3 * row + column * (np.pi / 16))) * np.ones((1, 1, 3))
    return {"type": "envmap", "bitmap": djpt.Bitmap(radiance.astype(np.float32))}


SPOTS = {
    "type": "bitmap",
    "data": TensorXf(0.2 + 0.8 * np.random.default_rng(0).random((5, 5, 3), np.float32)),
    "raw": True,
}
FLOOR = {"type": "rectangle", "to_world": T().scale(4)}
LAMP = {"type": "sphere", "center": [3, 3, 6], "radius": 0.5, "emitter": {"type": "area", "radiance": 60.0}}


@dataclass(frozen=True)
class Case:
    """A scene, what moves in it, and how it is rendered."""

    nodes: Callable[[], dict[str, Any]]
    move: Move
    kinds: tuple[str, ...] = ("direct_projective", "prb_projective")
    depth: int = 2
    step: float = 0.05
    spp: int = 256
    spp_difference: int = 4096
    settings: dict[str, Any] = field(default_factory=dict)
    thorough: bool = False
    """Whether the guide has much effort: with little, rare samples of great weight are missed, or prevail."""
    by: str = "path"
    """The integrator whose images have the differences."""

    def scene(self, theta: Float) -> Any:
        """The scene, moved."""
        scene = djpt.load_dict({"type": "scene", "sensor": sensor()} | self.nodes())
        params = djpt.traverse(scene)
        self.move(params, theta)
        params.update()
        return scene

    def difference(self) -> tuple[float, float]:
        """The change of the loss with theta by central differences, and its standard error."""
        hidden = {key: value for key, value in self.settings.items() if key == "hide_emitters"}
        path = djpt.load_dict({"type": self.by, "max_depth": self.depth, **hidden})
        found = []
        for seed in range(3):
            ahead, back = (
                np.array(djpt.render(self.scene(Float(x)), integrator=path, spp=self.spp_difference, seed=seed))
                for x in (self.step, -self.step)
            )
            found.append(float((WEIGHTS * (ahead - back)).sum() / (2 * self.step)))
        return float(np.mean(found)), float(np.std(found, ddof=1) / np.sqrt(3))

    def integrator(self, kind: str) -> Any:
        """The integrator, with little effort for its guide unless `thorough`."""
        found = djpt.load_dict({"type": kind, "max_depth": self.depth, **self.settings})
        if not self.thorough:
            found.proj_seed_spp, found.octree_extra_leaf_sample, found.octree_max_depth = 64, 8, 7
        else:
            found.proj_seed_spp, found.octree_extra_leaf_sample, found.octree_max_depth = 256, 32, 9
        return found

    def forward(self, kind: str, seed: int) -> float:
        """The change of the loss in forward mode."""
        theta = Float(0)
        dr.enable_grad(theta)
        scene = self.scene(theta)
        dr.forward(theta, dr.ADFlag.ClearEdges)
        change = np.array(self.integrator(kind).render_forward(scene, None, spp=self.spp, seed=seed))
        return float((WEIGHTS * change).sum())

    def reverse(self, kind: str, seed: int) -> float:
        """The derivative of the loss in reverse mode."""
        theta = Float(0)
        dr.enable_grad(theta)
        scene = self.scene(theta)
        self.integrator(kind).render_backward(scene, None, TensorXf(WEIGHTS), spp=self.spp, seed=seed)
        return float(dr.grad(theta)[0])

    def check(self, kind: str, name: str) -> None:
        """Assert that derivatives are those of differences, within 4 standard errors or 3 per cent, in both modes.

        The error of four estimates is itself an estimate, and too small now and then: sixteen decide where four are
        off.
        """
        expected, noise = self.difference()
        found: list[float] = []
        for seeds in (range(11, 15), range(15, 27)):
            found += [self.forward(kind, seed) for seed in seeds]
            error = float(np.hypot(np.std(found, ddof=1) / np.sqrt(len(found)), noise))
            print(f"{name}, {kind}: {np.mean(found):.4f} +- {error:.4f}, expected {expected:.4f}")
            right = abs(np.mean(found) - expected) < max(4 * error, 0.03 * abs(expected))
            if right and error < max(0.3 * abs(expected), 0.3):
                break
        assert right
        assert error < max(0.3 * abs(expected), 0.3)
        # Of sums that cancel, rounding is relative to what they vary by.
        assert self.reverse(kind, 14) == pytest.approx(found[3], rel=1e-4, abs=1e-4 * float(np.std(found, ddof=1)))


def ball(bsdf: Any = None, **more: Any) -> dict[str, Any]:
    """A sphere."""
    return {"type": "sphere", **({} if bsdf is None else {"bsdf": bsdf}), **more}


def plate(bsdf: Any) -> dict[str, Any]:
    """A large rectangle, which fills the picture."""
    return {"type": "rectangle", "to_world": T().scale(4), "bsdf": bsdf}


def quilt(uv: bool, attributes: dict[str, Any] | None = None, bend: float = 0.3) -> Any:
    """Nine squares of two triangles with vertices of their own: a whole picture on each, or on each triangle."""
    squares, corners = np.divmod(np.arange(36), 4)
    side = np.stack([corners % 2, corners // 2], -1)
    place = (np.stack([squares % 3, squares // 3], -1) + side) * 0.8 - 1.2
    points = np.concatenate([place, bend * place[:, :1] * place[:, 1:]], -1).astype(np.float32)
    faces = (4 * np.arange(9)[:, None, None] + np.array([[0, 1, 2], [1, 3, 2]])).reshape(-1, 3)
    pattern = {"type": "mesh_attribute", "name": next(iter(attributes))} if attributes else SPOTS
    props = {"bsdf": {"type": "diffuse", "reflectance": pattern}}
    normals = np.tile([0.0, 0.0, 1.0], (36, 1))
    return djpt.Mesh("moving", points, faces, normals, side if uv else None, props=props, attributes=attributes)


CASES: dict[str, Case] = {
    f"a quilt, {name}": Case(
        lambda make=make: {"moving": make(), "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0}},
        slide,
        spp=512,
    )
    for name, make in (
        ("a picture on each square", lambda: quilt(True, bend=0)),
        ("a picture on each triangle", lambda: quilt(False)),
        ("colours of faces", lambda: quilt(True, {"face_color": 0.1 + 0.8 * np.random.default_rng(1).random((18, 3))})),
    )
}
INTERIOR = {"sppp": 0, "sppi": 0}
PRB = ("prb_projective",)
CASES |= {
    "rough glass": Case(
        lambda: {"moving": ball({"type": "roughdielectric", "alpha": 0.3}), "sky": sky()},
        shift("moving.to_world"),
        PRB,
        depth=5,
        spp=2048,
        settings={"sppi": 0},
    ),
    "a flat mirror": Case(
        lambda: {"moving": plate({"type": "conductor"}), "sky": sky()}, turn("moving.to_world", 10), settings=INTERIOR
    ),
    "a flat plate of plastic": Case(
        lambda: {"moving": plate({"type": "plastic"}), "sky": sky()}, turn("moving.to_world", 10), settings=INTERIOR
    ),
    "a ball of plastic": Case(
        lambda: {"moving": ball({"type": "plastic"}), "sky": sky()},
        shift("moving.to_world"),
        spp=2048,
        settings={"sppi": 0},
    ),
    "a ball of glass": Case(
        lambda: {"moving": ball({"type": "dielectric"}), "sky": sky()},
        shift("moving.to_world"),
        PRB,
        depth=8,
        spp=4096,
        settings={"sppi": 0},
    ),
    "a lamp with a texture": Case(
        lambda: {
            "moving": {
                "type": "rectangle",
                "to_world": T().translate([0, 0, 7]).rotate([1, 0, 0], 180).scale(2),
                "emitter": {"type": "area", "radiance": SPOTS},
            },
            "floor": FLOOR,
        },
        shift("moving.to_world"),
        step=0.1,
    ),
}
BLOCKER = ball(center=[1, 1, 3], radius=0.4)
POINT = {"type": "point", "position": [2, 2, 6], "intensity": 40.0}
SUN = {"type": "directional", "direction": [-0.3, -0.3, -1.0], "irradiance": 2.0}
ASIDE = sensor((-2, -1, 5))
CASES |= {
    "the shadow of a ball in the light of a point": Case(
        lambda: {"moving": BLOCKER, "light": POINT, "floor": FLOOR, "sensor": ASIDE}, shift("moving.to_world")
    ),
    "the shadow of a ball in parallel light": Case(
        lambda: {"moving": BLOCKER, "light": SUN, "floor": FLOOR, "sensor": ASIDE}, shift("moving.to_world", 1, 0, 1)
    ),
    "the shadow of a ball in the light of a spot": Case(
        lambda: {
            "moving": BLOCKER,
            "light": {
                "type": "spot",
                "to_world": T().look_at([2, 2, 6], [0, 0, 0], [0, 1, 0]),
                "intensity": 60.0,
                "cutoff_angle": 30.0,
            },
            "floor": FLOOR,
            "sensor": ASIDE,
        },
        shift("moving.to_world"),
    ),
    "a floor that rises under a shadow in the light of a point": Case(
        lambda: {"blocker": BLOCKER, "light": POINT, "moving": FLOOR, "sensor": ASIDE},
        shift("moving.to_world", 0, 0, 1),
    ),
    "a floor that rises under the shadow of a lamp": Case(
        lambda: {"blocker": BLOCKER, "lamp": LAMP, "moving": FLOOR, "sensor": ASIDE},
        shift("moving.to_world", 0, 0, 1),
        thorough=True,
    ),
    "a shadow in indirect light": Case(
        lambda: {
            "moving": BLOCKER,
            "light": POINT,
            "floor": FLOOR,
            "wall": {"type": "rectangle", "to_world": T().translate([-3, 0, 0]).rotate([0, 1, 0], 90).scale(4)},
            "sensor": ASIDE,
        },
        shift("moving.to_world", 1, 0, 0),
        PRB,
        depth=4,
        spp=1024,
    ),
}


LIGHT = {"type": "point", "position": [0, 0, 6], "intensity": 40.0}
GREY = {**FLOOR, "bsdf": {"type": "diffuse", "reflectance": 0.2}}
DIPPED = ball({"type": "diffuse", "reflectance": 0.8}, center=[0, 0, -0.4])
BOX = T().rotate([0.6, 0.8, 0], 35).scale([0.8, 0.6, 1.0])


def corners(by: Callable[[Float], Any]) -> Move:
    """Map the corners of a cube or a mesh."""

    def move(params: Any, theta: Float) -> None:
        p = dr.unravel(Point3f, Float(params["moving.vertex_positions"]))
        params["moving.vertex_positions"] = Float(dr.ravel(by(theta).transform_point(p)))

    return move


aside = corners(lambda theta: djpt.Transform4f().translate([theta, 0.3 * theta, 0]))
spin = corners(lambda theta: djpt.Transform4f().rotate([0, 1, 0], 20 * theta))
HANGING = T().translate([1, 1, 3]).rotate([0.6, 0.8, 0], 35).scale(0.35)
WALL = {"type": "rectangle", "to_world": T().translate([-3, 0, 0]).rotate([0, 1, 0], 90).scale(4)}


def grow(params: Any, theta: Float) -> None:
    """Move a corner of a cuboid."""
    params["moving.max"] = Point3f(0.8 + theta, 0.6 + 0.5 * theta, 0.5 + theta)


CASES |= {
    "a cube in parallel light": Case(lambda: {"moving": {"type": "cube", "to_world": BOX}, "light": SUN}, spin),
    "a cuboid grows": Case(
        lambda: {
            "moving": {
                "type": "cuboid",
                "min": [-0.8, -0.6, -0.5],
                "max": [0.8, 0.6, 0.5],
                "to_world": T().rotate([0.6, 0.8, 0], 35),
            },
            "sky": sky(),
        },
        grow,
        spp=512,
        thorough=True,
    ),
    "the shadow of a cube in the light of a lamp": Case(
        lambda: {"moving": {"type": "cube", "to_world": HANGING}, "lamp": LAMP, "floor": FLOOR, "sensor": ASIDE},
        aside,
        spp=512,
        thorough=True,
    ),
    "a floor that rises under the shadow of a cube": Case(
        lambda: {"box": {"type": "cube", "to_world": HANGING}, "light": POINT, "moving": FLOOR, "sensor": ASIDE},
        shift("moving.to_world", 0, 0, 1),
    ),
    "a cube in indirect light": Case(
        lambda: {
            "moving": {"type": "cube", "to_world": T().translate([0.5, 0.5, 1.2]).rotate([0.6, 0.8, 0], 35).scale(0.5)},
            "light": POINT,
            "floor": FLOOR,
            "wall": WALL,
            "sensor": sensor((-1, -1, 6)),
        },
        aside,
        PRB,
        depth=4,
        spp=1024,
        thorough=True,
    ),
    "flat facets in indirect light": Case(
        lambda: {
            "moving": octahedron((0.5, 0.5, 1.5), 0.8),
            "light": POINT,
            "floor": FLOOR,
            "wall": WALL,
            "sensor": sensor((-1, -1, 6)),
        },
        slide,
        PRB,
        depth=4,
        spp=1024,
        thorough=True,
    ),
    "a cone": Case(
        lambda: {
            "moving": {"type": "cone", "to_world": T().rotate([0.6, 0.8, 0], 70).scale([0.8, 0.8, 1.5])},
            "light": {"type": "point", "position": [1, 2, 6], "intensity": 40.0},
            "floor": GREY,
        },
        turn("moving.to_world", 20),
        spp=512,
    ),
    "a paraboloid": Case(
        lambda: {
            "moving": {"type": "paraboloid", "to_world": T().translate([0, 0, 0.5]).rotate([0.6, 0.8, 0], 100)},
            "sky": sky(),
            "floor": {**GREY, "to_world": T().translate([0, 0, -2]).scale(4)},
        },
        turn("moving.to_world", 20),
        spp=512,
        thorough=True,
    ),
}


def placed(name: str, place: Any) -> dict[str, Any]:
    """An instance of a group of three shapes."""
    group = {
        "type": "shapegroup",
        "mesh": octahedron((0.3, 0.1, 0), 0.5),
        "ball": ball(center=[-0.5, 0, 0], radius=0.4),
        "box": {"type": "cube", "to_world": T().translate([0.2, 0.9, 0]).scale(0.3)},
    }
    return {"group": group, name: {"type": "instance", "to_world": place, "of": {"type": "ref", "id": "group"}}}


CASES |= {
    "an instance": Case(
        lambda: {**placed("moving", T().rotate([0.6, 0.8, 0], 30)), "light": SUN}, shift("moving.to_world"), spp=512
    ),
    "a floor that rises under the shadow of an instance": Case(
        lambda: {
            **placed("other", T().translate([1, 1, 3]).rotate([0.6, 0.8, 0], 30).scale(0.5)),
            "light": POINT,
            "moving": FLOOR,
            "sensor": ASIDE,
        },
        shift("moving.to_world", 0, 0, 1),
        spp=512,
    ),
    "a camera, turn: an instance": Case(
        lambda: {**placed("other", T().rotate([0.6, 0.8, 0], 30)), "light": SUN},
        turn_head,
        spp=512,
    ),
}
CASES |= {
    "a ball rises from a floor": Case(
        lambda: {"moving": DIPPED, "floor": GREY, "light": LIGHT}, shift("moving.to_world", 0, 0, 1), spp=512
    ),
    "a floor rises about a ball": Case(
        lambda: {"ball": DIPPED, "moving": GREY, "light": SUN}, shift("moving.to_world", 0, 0, 1), spp=1024
    ),
    "flat facets": Case(lambda: {"moving": octahedron((0.1, 0.2, 0), 1.2), "light": SUN}, slide, spp=512),
    "half of a ball": Case(
        lambda: {
            "moving": ball({"type": "mask", "opacity": 0.5, "nested": {"type": "diffuse"}}),
            "sky": {"type": "constant", "radiance": 0.3},
        },
        shift("moving.to_world"),
        PRB,
        depth=6,
        spp=512,
        settings={"sppi": 0},
    ),
    "a hidden lamp": Case(
        lambda: {
            "moving": ball(),
            "near": {
                "type": "sphere",
                "center": [0.8, 0.3, 2.5],
                "radius": 0.4,
                "emitter": {"type": "area", "radiance": 5.0},
            },
            "sky": {"type": "constant", "radiance": 0.3},
        },
        shift("moving.to_world"),
        spp=1024,
        settings={"hide_emitters": True},
        thorough=True,
    ),
}
