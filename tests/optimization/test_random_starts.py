"""Variables that brighten some pixels and darken others are found from ten random starts each, and none diverges."""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.optimization import least_squares

pytestmark = pytest.mark.slow

T = djpt.ScalarTransform4f
GREY = {"type": "diffuse", "reflectance": 0.5}


def camera(size: int, origin: list[float], target: list[float], fov: float) -> dict[str, Any]:
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "film": film, "to_world": T().look_at(origin, target, [0, 0, 1])}


def lamp(origin: list[float], target: list[float], scale: float, radiance: list[float]) -> dict[str, Any]:
    to_world = T().look_at(origin, target, [0, 0.1, 1]).scale(scale)
    return {
        "type": "rectangle",
        "to_world": to_world,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }


class Place:
    """The place of a ball over a floor: three numbers."""

    truth = np.array([0.25, -0.2, 0.55])
    close, spp = 0.02, 8
    options: ClassVar[dict[str, Any]] = {"iterations": 10, "coarse": 3, "differences": {"x": 0.15}}
    body: ClassVar[dict[str, Any]] = {"type": "sphere", "radius": 0.4, "bsdf": {"type": "diffuse", "reflectance": 0.15}}

    def __init__(self) -> None:
        self.scene = djpt.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": camera(48, [0, -3, 2.5], [0, 0, 0.3], 45),
                "floor": {"type": "rectangle", "to_world": T().scale(3), "bsdf": GREY},
                "sky": {"type": "constant", "radiance": 0.5},
                "light": {"type": "point", "position": [1, -2, 3], "intensity": 20.0},
                "body": self.body,
            }
        )
        self.params = djpt.traverse(self.scene)

    def start(self, rng: np.random.Generator) -> Any:
        return djpt.Float(rng.uniform([-0.6, -0.6, 0.4], [0.6, 0.6, 0.9]))

    def set(self, x: Any) -> None:
        self.params["body.to_world"] = djpt.Transform4f().translate(np.array(x, float).tolist())
        self.params.update()

    def error(self, x: Any) -> float:
        return float(np.abs(np.array(x).reshape(self.truth.shape) - self.truth).mean())


class Pose(Place):
    """Place and turn of a box on a floor: six numbers. It may begin 40 degrees from its turn."""

    truth = np.array([0.1, -0.1, 0.45, 0.2, 0.3, 0.5])
    options: ClassVar[dict[str, Any]] = {"iterations": 14, "coarse": 1, "differences": {"x": 0.2}}
    body: ClassVar[dict[str, Any]] = {
        "type": "cube",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.15]}},
    }

    def __init__(self) -> None:
        super().__init__()
        self.corners = np.array(self.params["body.vertex_positions"], float).reshape(-1, 3)

    def start(self, rng: np.random.Generator) -> Any:
        return djpt.Float(self.truth + rng.uniform([-0.3] * 3 + [-0.5] * 3, [0.3] * 3 + [0.5] * 3))

    def set(self, x: Any) -> None:
        place, turn = np.split(np.array(x, float), 2)
        angle = float(np.linalg.norm(turn))
        to_world = T().translate(place.tolist())
        if angle > 0:
            to_world = to_world.rotate((turn / angle).tolist(), np.degrees(angle))
        matrix = np.array(to_world.scale([0.45, 0.3, 0.2]).matrix, float)
        moved = self.corners @ matrix[:3, :3].T + matrix[:3, 3]
        self.params["body.vertex_positions"] = djpt.Float(moved.ravel().astype(np.float32))
        self.params.update()


class Roughness(Place):
    """The roughness of a metal plate, 4 x 4 texels, in the reflections of as many lamps."""

    truth = np.random.default_rng(2).uniform(0.15, 0.7, (4, 4, 1))
    close, spp = 0.04, 16
    options: ClassVar[dict[str, Any]] = {"iterations": 16, "bounds": {"x": (0.05, 1.0)}}

    def __init__(self) -> None:
        rough = {
            "type": "bitmap",
            "data": self.truth.astype(np.float32),
            "raw": True,
            "filter_type": "bilinear",
        }
        metal = {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.7, 0.5]}, "metallic": 0.9}
        self.scene = djpt.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "prb", "max_depth": 2},
                "sensor": camera(32, [0, -2.2, 2.2], [0, 0, 0], 42),
                "body": {"type": "rectangle", "bsdf": {**metal, "roughness": rough}},
                "sky": {"type": "constant", "radiance": 0.1},
                **self.lamps(),
            }
        )
        self.params = djpt.traverse(self.scene)

    def lamps(self) -> dict[str, Any]:
        """A lamp in the mirrored direction of each texel's centre."""
        eye, found = np.array([0, -2.2, 2.2]), {}
        for k in range(16):
            p = np.array([k % 4 / 2 - 0.75, k // 4 / 2 - 0.75, 0])
            d = (p - eye) / np.linalg.norm(p - eye) * [1, 1, -1]
            found[f"lamp{k}"] = lamp((p + 1.2 * d).tolist(), p.tolist(), 0.08, [20.0] * 3)
        return found

    def start(self, rng: np.random.Generator) -> Any:
        return djpt.TensorXf(rng.uniform(0.1, 0.9, (4, 4, 1)).astype(np.float32))

    def set(self, x: Any) -> None:
        self.params["body.bsdf.roughness.data"] = x
        self.params.update()


class Normals(Roughness):
    """The slopes of a surface, 4 x 4 texels of two numbers, under lamps of three colours (Woodham 1980)."""

    truth = np.random.default_rng(14).uniform(-0.4, 0.4, (4, 4, 2))
    close, spp = 0.04, 32
    options: ClassVar[dict[str, Any]] = {"iterations": 8, "bounds": {"x": (-1.0, 1.0)}}
    key = "body.bsdf.normalmap.data"

    def __init__(self) -> None:
        flat = {"type": "bitmap", "data": np.full((4, 4, 3), 0.5, np.float32), "raw": True, "filter_type": "bilinear"}
        paint = {"type": "diffuse", "reflectance": 0.6}
        centre = [0.0, 0.0, 0.0]
        self.scene = djpt.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "prb", "max_depth": 2},
                "sensor": camera(48, [0, -0.5, 3], [0, 0, 0], 42),
                "body": {"type": "rectangle", "bsdf": {"type": "normalmap", "normalmap": flat, "bsdf": paint}},
                "red": lamp([2, 0, 2], centre, 0.3, [30, 2, 2]),
                "green": lamp([-1, 1.7, 2], centre, 0.3, [2, 30, 2]),
                "blue": lamp([-1, -1.7, 2], centre, 0.3, [2, 2, 30]),
            }
        )
        self.params = djpt.traverse(self.scene)

    def start(self, rng: np.random.Generator) -> Any:
        return djpt.TensorXf(rng.uniform(-0.4, 0.4, (4, 4, 2)).astype(np.float32))

    def set(self, x: Any) -> None:
        index = dr.arange(djpt.UInt32, 48)
        texel, axis = index // 3, index % 3
        u, v = (dr.gather(djpt.Float, x.array, 2 * texel + k) for k in (0, 1))
        component = dr.select(axis == 0, u, dr.select(axis == 1, v, 1)) * dr.rsqrt(1 + u * u + v * v)
        self.params[self.key] = djpt.TensorXf(0.5 + 0.5 * component, (4, 4, 3))
        self.params.update()


@pytest.mark.parametrize("kind", [Place, Pose, Roughness, Normals])
def test_ten_random_starts(kind: type[Place]) -> None:
    problem = kind()

    def image(x: Any, seed: int, spp: int) -> Any:
        problem.set(x)
        return djpt.render(problem.scene, problem.params, spp=spp, seed=seed)

    starts = [problem.start(np.random.default_rng(number)) for number in range(10)]
    target = dr.detach(image(type(starts[0])(problem.truth.astype(np.float32)), 9999, 1024))
    dr.eval(target)
    ends = []
    for number, start in enumerate(starts):
        found = least_squares(
            lambda x, seed: image(x["x"], seed, problem.spp) - target, {"x": start}, seed=number, **problem.options
        )
        ends.append(problem.error(found.average["x"]))
        # With the same pixels and samples, losses never rise by more than noise.
        assert found.losses[-1] < 2 * found.losses[0] or problem.options.get("coarse")
    begun = np.array([problem.error(start) for start in starts])
    print(kind.__name__, np.round(begun, 3), np.round(ends, 4))
    assert np.all(np.isfinite(ends)) and np.all(ends < np.maximum(begun, problem.close))
    assert np.count_nonzero(np.array(ends) < problem.close) >= 8
