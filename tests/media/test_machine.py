"""Media in the machine schedule: the images of the flat schedule, path for path."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.rendering.schedules.choice import choose
from tests.kit.media_scenes import GLASS, NULL, colour, fog, foggy_room, lit_ball
from tests.kit.mesh_scenes import ball_file
from tests.kit.renders import ours, pixels

PLACE = T().translate([-1, -1, -1]).scale(2)
LAMP = {"type": "sphere", "center": [0, 2, 1], "radius": 0.3, "emitter": {"type": "area", "radiance": colour(9, 6, 3)}}


def grid(channels: int = 1, wrap: str = "clamp") -> dict[str, Any]:
    """Wisps in the cube [-1, 1]^3: mostly thin, partly empty."""
    numbers = np.random.default_rng(0).random((10, 12, 14, channels)).astype(np.float32) ** 4
    numbers[:, :4] = 0
    return {"type": "gridvolume", "data": numbers, "to_world": PLACE, "wrap_mode": wrap}


def smoke(channels: int = 1, albedo: Any = 0.8, **more: Any) -> dict[str, Any]:
    medium = {"type": "heterogeneous", "sigma_t": grid(channels), "albedo": albedo, "scale": 8.0}
    return {**medium, "phase": {"type": "hg", "g": 0.4}, **more}


def cloud(medium: dict[str, Any], integrator: str = "volpath", **nodes: Any) -> dict[str, Any]:
    """A cube of a medium under a grey sky, beside a lamp."""
    scene = lit_ball(None, integrator=integrator, max_depth=8, lamp=LAMP, **nodes)
    del scene["ball"]
    scene["cube"] = {"type": "cube", "to_world": T().scale(1.01), "bsdf": NULL, "interior": medium}
    return scene


def room_of_smoke(_: Path) -> dict[str, Any]:
    return foggy_room(smoke())


def without_null_surfaces(_: Path) -> dict[str, Any]:
    """The camera and all walls are in one medium."""
    return foggy_room(smoke(scale=2.0), around=True)


def several(_: Path) -> dict[str, Any]:
    """Grey and coloured smoke, fog, and glass that absorbs, side by side and one within another."""
    scene = foggy_room(fog(colour(0.2, 0.3, 0.5), 0.9), "volpathmis")
    inner = scene["fog"]["interior"]
    for name, x, medium in (("grey", -0.4, smoke()), ("coloured", 0.4, smoke(3, emission=0.1))):
        medium["sigma_t"]["to_world"] = T().translate([x, 0, 0]).scale(0.3) @ PLACE
        shape = {"type": "sphere", "center": [x, 0, 0], "radius": 0.3, "bsdf": NULL}
        scene[name] = {**shape, "interior": medium, "exterior": inner}
    glass = {**GLASS, "absorption": colour(0.5, 1, 2)}
    scene["glass"] = {"type": "sphere", "center": [0, 0.5, 0.3], "radius": 0.2, "bsdf": glass, "exterior": inner}
    return scene


def stone(folder: Path) -> dict[str, Any]:
    """An opaque mesh."""
    place = T().translate([0.3, 0.2, 0]).scale(0.3)
    return {"type": "ply", "filename": ball_file(folder, 8), "to_world": place, "bsdf": {"type": "diffuse"}}


def in_a_mesh(folder: Path) -> dict[str, Any]:
    """A null boundary of triangles, and an opaque mesh within it."""
    scene = cloud(smoke(), sky={"type": "constant", "radiance": 0.2})
    scene["cube"] = {"type": "ply", "filename": ball_file(folder), "bsdf": NULL, "interior": smoke()}
    scene["stone"] = stone(folder)
    return scene


def beside_a_mesh(folder: Path) -> dict[str, Any]:
    """Null surfaces are unrolled, other shapes stand in a tree."""
    scene = cloud(smoke(3, emission=colour(0.1, 0.2, 0.0)), "volpathmis")
    scene["stone"] = stone(folder)
    return scene


def under_a_map(_: Path) -> dict[str, Any]:
    sky = np.random.default_rng(1).random((4, 8, 3)).astype(np.float32)
    return cloud(smoke(), sky={"type": "envmap", "bitmap": djpt.Bitmap(sky)})


def hidden(_: Path) -> dict[str, Any]:
    scene = cloud(smoke())
    scene["integrator"]["hide_emitters"] = True
    scene["sensor"]["film"]["pixel_format"] = "rgba"
    return scene


SCENES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "room of smoke": room_of_smoke,
    "without null surfaces": without_null_surfaces,
    "several media": several,
    "in a mesh": in_a_mesh,
    "beside a mesh": beside_a_mesh,
    "under a map": under_a_map,
    "hidden emitters": hidden,
    "fog": lambda _: foggy_room(fog(colour(0.5, 0.9, 1.4), 0.9)),
    "no media": lambda _: foggy_room(fog()) | {"fog": LAMP},
    "glowing": lambda _: cloud(smoke(emission=colour(0.3, 0.1, 0.0))),
}


SLOW = ("under a map", "hidden emitters", "fog", "no media", "glowing")


@pytest.mark.sparse(6)
@pytest.mark.parametrize("name", [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in SCENES])
def test_as_flat(name: str, tmp_path: Path) -> None:
    """Equal to rounding: each sample has the same random numbers, in the same order."""
    scene = djpt.load_dict(SCENES[name](tmp_path))
    machine, flat = (pixels(djpt.render(scene, spp=8, seed=3, schedule=how)) for how in ("machine", "flat"))
    assert flat.max() > 0 and np.isfinite(machine).all()
    close = np.isclose(machine, flat, rtol=1e-4, atol=1e-5).all(axis=-1)
    # Rounding may decide where a ray that grazes an edge goes.
    assert close.mean() >= 0.99


def test_a_wide_filter_and_odd_sizes(tmp_path: Path) -> None:
    scene = room_of_smoke(tmp_path)
    scene["sensor"]["film"].update(width=19, height=7, rfilter={"type": "gaussian"})
    machine, flat = (ours(scene, spp=5, schedule=how) for how in ("machine", "flat"))
    np.testing.assert_allclose(machine, flat, rtol=1e-3, atol=1e-4)


def test_images_are_repeatable(tmp_path: Path) -> None:
    """The same bits whatever the passes."""
    scene = djpt.load_dict(room_of_smoke(tmp_path))
    first, *others = (pixels(djpt.render(scene, spp=12, seed=5, schedule="machine", pass_spp=n)) for n in (0, 0, 5))
    for other in others:
        np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize(
    "medium",
    [
        smoke(1, 1.0),
        pytest.param(smoke(3, 1.0), marks=pytest.mark.slow),
        pytest.param(fog(3.0, 1.0), marks=pytest.mark.slow),
    ],
    ids=["grey", "coloured", "fog"],
)
def test_furnace(medium: dict[str, Any]) -> None:
    """What only scatters is invisible under a white sky."""
    scene = lit_ball(None, max_depth=-1)
    scene["ball"] = {"type": "cube", "to_world": T().scale(1.01), "bsdf": NULL, "interior": medium}
    loaded = djpt.load_dict(scene)
    means = [pixels(djpt.render(loaded, spp=128, seed=seed, schedule="machine")).mean() for seed in range(8)]
    error = np.std(means, ddof=1) / np.sqrt(8)
    assert abs(np.mean(means) - 1) < 4 * error and error < 5e-3


def test_furnace_in_glass() -> None:
    image = ours(lit_ball(smoke(1, 1.0), GLASS), spp=512, schedule="machine")
    assert image.mean() == pytest.approx(1, abs=2e-3)


def test_gradients_are_those_of_flat(tmp_path: Path) -> None:
    scene = djpt.load_dict(room_of_smoke(tmp_path))
    params, gradients = djpt.traverse(scene), []
    key = "fog.interior_medium.albedo.value.value"
    for how in ("machine", "flat"):
        attached = djpt.Float(0.6)
        dr.enable_grad(attached)
        params[key] = attached
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params, spp=4, seed=1, schedule=how), axis=None))
        gradients.append(dr.grad(attached)[0])
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-4) and gradients[0] > 0


def test_an_edit_compiles_no_kernel(tmp_path: Path) -> None:
    scene = djpt.load_dict(room_of_smoke(tmp_path))
    params = djpt.traverse(scene)
    before = pixels(djpt.render(scene, spp=2, schedule="machine"))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        params["fog.interior_medium.scale"] = 20.0
        params.update()
        after = pixels(djpt.render(scene, spp=2, schedule="machine"))
        compiled = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    assert not compiled and np.abs(before - after).max() > 0.01


@pytest.mark.parametrize(("name", "expected"), [("room of smoke", "machine"), ("fog", "flat"), ("no media", "flat")])
def test_choice(name: str, expected: str, tmp_path: Path) -> None:
    """State machines where flights are tracked: elsewhere no lane waits for another."""
    from djpt.rendering.image import make_job
    from djpt.rendering.settings import RenderSettings

    scene = djpt.load_dict(SCENES[name](tmp_path))
    assert choose("auto", make_job(scene, RenderSettings.of(scene, spp=1))).name == expected
