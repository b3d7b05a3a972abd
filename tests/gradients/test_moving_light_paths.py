"""Derivatives of what light paths show, by shapes that move: against differences of the same paths."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError
from djpt.jit.types import Float, Point3f, TensorXf
from djpt.rendering.gradients import moving_light_paths
from tests.kit.meshes import bumpy_sheet, write_binary_ply
from tests.kit.renders import box

SIZE, SPP, SEEDS = 12, 128, range(8)
COLUMN = np.linspace(-1, 1, SIZE, dtype=np.float32)
WEIGHTS = np.broadcast_to(np.sin(2 * COLUMN[None, :, None] + 1) + 0.5 * COLUMN[:, None, None], (SIZE, SIZE, 3)).copy()
"""The derivative of a loss by the pixels."""

TRACER = {"type": "ptracer", "max_depth": 4, "rr_depth": 100, "unproven_gradients": True}
SMOOTH = {"type": "gaussian"}
PLACE = T().translate([0, 0, 0.8]).rotate([1, 0, 0], 180)
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": 0.0}

slow = pytest.mark.slow
Move = Callable[[Any, Float], None]


def rectangle(z: float, size: float, facing: float = 0.0) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": T().translate([0, 0, z]).rotate([1, 0, 0], facing).scale(size)}


def lens_of(folder: Path, glass: dict[str, Any] = GLASS) -> dict[str, Any]:
    """The lower side of a slab, a mesh with smooth normals."""
    sheet = bumpy_sheet(6)
    sheet["positions"][:, 2] *= 0.1
    file = write_binary_ply(folder / "lens.ply", sheet, normals=False)
    return {"type": "ply", "filename": str(file), "to_world": PLACE, "bsdf": glass}


def scene(
    folder: Path,
    glass: dict[str, Any] = GLASS,
    integrator: dict[str, Any] = TRACER,
    rfilter: dict[str, Any] = SMOOTH,
    **edits: Any,
) -> Any:
    """A slab of glass, whose lower side is a mesh, throws parallel light onto a floor, of which a camera sees all."""
    nodes = {
        "sensor": {
            "type": "perspective",
            "fov": 60,
            "to_world": T().look_at([0, 0, 0.1], [0, 0, -1], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb", "rfilter": rfilter},
        },
        "floor": {**rectangle(-3, 5), "bsdf": {"type": "diffuse", "reflectance": 0.9}},
        "lens": lens_of(folder, glass),
        "back": {**rectangle(1, 1), "bsdf": glass},
        "lamp": {
            **rectangle(2, 0.9, 180),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "directionalarea", "radiance": {"type": "rgb", "value": [1.0, 0.8, 0.5]}},
        },
    }
    nodes = {name: node for name, node in {**nodes, **edits}.items() if node is not None}
    return djpt.load_dict({"type": "scene", "integrator": integrator, **nodes})


def bulge(params: Any, theta: Float) -> None:
    """Give the lens other heights, all of its vertices but those of its border, along the light."""
    p = dr.unravel(Point3f, Float(params["lens.vertex_positions"]))
    inside = dr.maximum(dr.abs(p.x), dr.abs(p.y)) < 0.99
    height = dr.select(inside, theta * (0.3 * dr.sin(3 * p.x + 1) + 0.2 * dr.cos(2 * p.y)), 0)
    params["lens.vertex_positions"] = dr.ravel(Point3f(p.x, p.y, p.z + height))


def lift(params: Any, theta: Float) -> None:
    """Move the lens along the light."""
    p = dr.unravel(Point3f, Float(params["lens.vertex_positions"]))
    params["lens.vertex_positions"] = dr.ravel(Point3f(p.x, p.y, p.z + theta))


def moved(key: str, transform: Callable[[Float], Any]) -> Move:
    def move(params: Any, theta: Float) -> None:
        params[key] = transform(theta) @ djpt.Transform4f(params[key])

    return move


def tilted(key: str, degrees: float) -> Move:
    return moved(key, lambda theta: djpt.Transform4f().rotate([0.6, 0.8, 0], degrees * theta))


def slopes(scene: Any, move: Move, spp: int = SPP, step: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """For each seed the derivative of the loss in reverse mode, and by central differences."""
    params = djpt.traverse(scene)
    start = {key: params[key] for key in params if key.endswith(("to_world", "vertex_positions"))}

    def image(theta: Float, seed: int) -> TensorXf:
        params.update(start)
        move(params, theta)
        params.update()
        return djpt.render(scene, params, spp=spp, seed=seed, seed_grad=seed)

    found, differences = [], []
    for seed in SEEDS:
        theta = Float(0)
        dr.enable_grad(theta)
        dr.backward(dr.sum(image(theta, seed) * TensorXf(WEIGHTS), axis=None))
        found.append(dr.grad(theta)[0])
        ahead, behind = (image(Float(at), seed).numpy() for at in (step, -step))
        differences.append(((ahead - behind) * WEIGHTS).sum() / (2 * step))
    return np.array(found), np.array(differences)


MIRROR = {
    "type": "rectangle",
    "to_world": T().translate([0, 0, 2]).rotate([0, 1, 0], 225).scale(1.5),
    "bsdf": {"type": "twosided", "inner": {"type": "conductor", "material": "none"}},
}
BESIDE = {
    "type": "rectangle",
    "to_world": T().translate([-3, 0, 2]).rotate([0, 1, 0], 90).scale(0.8),
    "emitter": {"type": "directionalarea", "radiance": 1.0},
}
sink = moved("floor.to_world", lambda theta: djpt.Transform4f().translate([0, 0, -theta]))
FROSTED = {"type": "roughdielectric", "alpha": 0.2, "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": 0.0}
CASES: dict[str, tuple[Move, dict[str, Any]]] = {
    "heights of a lens": (bulge, {}),
    "a lens, along the light": (lift, {}),
    "the other side of the glass, tilted": (tilted("back.to_world", 10), {}),
    "heights of frosted glass": (bulge, {"glass": FROSTED}),
    "a floor, down": (sink, {}),
    "a floor, tilted": (tilted("floor.to_world", 20), {}),
    "a mirror, tilted": (tilted("back.to_world", 10), {"lens": None, "back": MIRROR, "lamp": BESIDE}),
}

NOISY = ("heights of frosted glass",)


@pytest.mark.parametrize("name", [n if n == "heights of a lens" else pytest.param(n, marks=slow) for n in CASES])
def test_derivatives_are_those_of_differences(tmp_path: Path, name: str) -> None:
    move, edits = CASES[name]
    found, differences = slopes(scene(tmp_path, **edits), move, 16 * SPP if name in NOISY else SPP)
    expected = differences.mean()
    error = np.std(found - differences, ddof=1) / np.sqrt(len(found))
    assert abs(found.mean() - expected) < 4 * error + 0.01 * abs(expected)
    assert error < 0.05 * abs(expected)


def test_modes_agree_for_all_parameters_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Heights, a floor that sinks, its paint, the colour of the lamp: in passes, whatever their number."""
    rendered = scene(tmp_path)
    params = djpt.traverse(rendered)
    keys = ("lens.vertex_positions", "floor.to_world", "floor.bsdf.reflectance.value", "lamp.emitter.radiance.value")
    start = {key: params[key] for key in keys}

    def image() -> tuple[Float, TensorXf]:
        theta = dr.opaque(Float, 0)
        dr.enable_grad(theta)
        params.update(start)
        bulge(params, theta)
        sink(params, theta)
        for key in keys[2:]:
            params[key] = params[key] * (1 - 0.3 * theta)
        params.update()
        return theta, djpt.render(rendered, params, spp=16)

    theta, found = image()
    dr.backward(dr.sum(found * TensorXf(WEIGHTS), axis=None))
    reverse = dr.grad(theta)[0]
    assert reverse != 0
    monkeypatch.setattr(moving_light_paths, "PASS_PATHS", 1000)
    theta, found = image()
    dr.forward(theta)
    assert (dr.grad(found).numpy() * WEIGHTS).sum() == pytest.approx(reverse, rel=1e-5)


def test_copies_of_a_lens_move_with_it(tmp_path: Path) -> None:
    """An instance of the lens has the derivatives that the lens has in its place."""

    def change(**edits: Any) -> float:
        rendered = scene(tmp_path, **edits)
        params = djpt.traverse(rendered)
        theta = Float(0)
        dr.enable_grad(theta)
        lens = next(key for key in ("placed.to_world", "lens.vertex_positions") if key in params)
        if lens == "placed.to_world":
            params[lens] = djpt.Transform4f().translate([0, 0, theta]) @ djpt.Transform4f(params[lens])
        else:
            lift(params, theta)
        params.update()
        image = djpt.render(rendered, params, spp=16)
        dr.backward(dr.sum(image * TensorXf(WEIGHTS), axis=None))
        return float(dr.grad(theta)[0])

    own = {**lens_of(tmp_path), "to_world": T()}
    group = {"type": "shapegroup", "lens": own}
    placed = {"type": "instance", "to_world": PLACE, "group": {"type": "ref", "id": "group"}}
    assert change(lens=None, group=group, placed=placed) == pytest.approx(change(), rel=1e-3)


@pytest.mark.parametrize(
    ("edits", "integrator", "move", "message"),
    [
        ({}, {"unproven_gradients": False}, bulge, "follows no silhouettes.*unproven_gradients"),
        ({}, {"max_depth": -1}, bulge, "'max_depth' -1; possible: 0 to 16"),
        ({"rfilter": {"type": "box"}}, {}, bulge, "slope of the filter"),
        ({}, {}, tilted("lamp.to_world", 10), "shines"),
    ],
)
def test_what_is_not_followed_is_refused(
    tmp_path: Path, edits: dict[str, Any], integrator: dict[str, Any], move: Move, message: str
) -> None:
    rendered = scene(tmp_path, integrator={**TRACER, **integrator}, **edits)
    params = djpt.traverse(rendered)
    theta = Float(0)
    dr.enable_grad(theta)
    move(params, theta)
    params.update()
    with pytest.raises(RenderError, match=message):
        dr.eval(djpt.render(rendered, params, spp=1))


@pytest.mark.parametrize("integrator", ["ptracer", "bdpt"])
@pytest.mark.parametrize(
    ("light", "parameter"),
    [
        ({"type": "point", "position": [0, 0.5, 0.2]}, "position"),
        ({"type": "spot", "to_world": T().look_at([0, 0.9, 0], [0, 0, 0], [0, 0, 1])}, "to_world"),
        ({"type": "directional", "direction": [0, 0, -1]}, "to_world"),
        ({"type": "projector", "to_world": T().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])}, "to_world"),
        ({"type": "envmap", "bitmap": np.ones((4, 8, 3), np.float32)}, "to_world"),
    ],
)
def test_light_paths_do_not_move_with_lights(integrator: str, light: dict[str, Any], parameter: str) -> None:
    rendered = djpt.load_dict(box(8, integrator={**TRACER, "type": integrator}, edit=lambda d: d.update(moved=light)))
    params = djpt.traverse(rendered)
    dr.enable_grad(params[f"moved.{parameter}"])
    params.update()
    with pytest.raises(RenderError, match=r"'moved' moves with parameters .* that begin at it don't"):
        dr.eval(djpt.render(rendered, params, spp=1))
