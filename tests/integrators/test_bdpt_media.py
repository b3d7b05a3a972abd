"""`bdpt` among media that scatter light: the means of `volpath`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError
from tests.kit.convergence import assert_equal_means, images
from tests.kit.media_scenes import GLASS, NULL, colour, fog, foggy_room, lit_ball
from tests.kit.phases import FLAKES, described

slow = pytest.mark.slow
POINT = {"type": "point", "position": [2.0, 2.0, 2.0], "intensity": 20.0}


def smoke(**keys: Any) -> dict[str, Any]:
    """A grid of random densities."""
    density = np.random.default_rng(1).random((8, 8, 8, 1)).astype(np.float32)
    place = T().translate([-0.8, -0.8, -0.8]).scale(1.6)
    grid = {"type": "gridvolume", "data": djpt.TensorXf(density), "to_world": place}
    return {"type": "heterogeneous", "albedo": 0.8, "scale": 6.0, "sigma_t": grid, **keys}


def ball_in_fog() -> dict[str, Any]:
    """A glass ball in a room full of fog."""
    scene = foggy_room(fog(0.4, 0.9), around=True)
    scene["sphere"] = {"type": "sphere", "center": [0.0, -0.3, 0.0], "radius": 0.4, "bsdf": GLASS}
    return scene


def window() -> dict[str, Any]:
    """Fog behind a half open surface, and a surface in it."""
    scene = foggy_room(fog(1.0, 0.8))
    scene["fog"]["bsdf"] = {"type": "mask", "opacity": 0.3, "inner": {"type": "diffuse"}}
    scene["ball"] = {"type": "sphere", "radius": 0.3}
    return scene


SCENES: dict[str, Callable[[], dict[str, Any]]] = {
    "a cube of fog": lambda: foggy_room(fog(3.0, 0.8)),
    "fog everywhere": lambda: foggy_room(fog(0.4, colour(0.9, 0.8, 0.5)), around=True),
    "ahead": lambda: foggy_room(fog(3.0, 0.9, phase={"type": "hg", "g": 0.7})),
    "coloured": lambda: foggy_room(fog(colour(1.0, 2.0, 3.0), 0.8)),
    "glowing": lambda: foggy_room(fog(2.0, 0.8, emission=0.5)),
    "smoke": lambda: foggy_room(smoke()),
    "coloured smoke": lambda: foggy_room(smoke(albedo=colour(0.9, 0.6, 0.3))),
    "a point and the sky": lambda: lit_ball(fog(2.0, 0.8), point=POINT),
    "in glass": lambda: lit_ball(fog(2.0, 0.8), bsdf=GLASS),
    "a ball in fog": ball_in_fog,
    "a window": window,
}


def without_lamps(scene: dict[str, Any]) -> np.ndarray:
    """1 where no lamp is seen directly: pixels at the edges of lamps are too noisy to tell anything."""
    straight = djpt.load_dict({"type": "volpath", "max_depth": 1})
    seen = np.array(djpt.render(djpt.load_dict(scene), integrator=straight, spp=256))
    lamp = (seen.max(axis=2, keepdims=True) > 0) & (seen.min() == 0)
    return 1.0 * ~lamp


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name == "a cube of fog" else slow) for name in SCENES])
@pytest.mark.slow
def test_scenes(name: str) -> None:
    scene = SCENES[name]()
    where = without_lamps(scene)
    for depth in (4,) if name == "a cube of fog" else (2, 3, 6):
        ours = images(scene, {"type": "bdpt", "max_depth": depth}, 128)
        assert_equal_means(ours, images(scene, {"type": "volpath", "max_depth": depth}, 512, 100), 8, where)


@slow
@pytest.mark.parametrize("name", FLAKES)
def test_flakes(name: str) -> None:
    """Media whose extinction depends on the direction."""
    scene = foggy_room(fog(3.0, 0.8, phase=described(name)))
    where = without_lamps(scene)
    for depth in (2, 4):
        ours = images(scene, {"type": "bdpt", "max_depth": depth}, 256)
        assert_equal_means(ours, images(scene, {"type": "volpath", "max_depth": depth}, 1024, 100), 8, where)


@slow
@pytest.mark.parametrize("keys", [{"hide_emitters": True}, {"heuristic": "balance"}], ids=str)
def test_options(keys: dict[str, Any]) -> None:
    scene = foggy_room(fog(1.0, 0.8))
    where = without_lamps(scene)
    ours = images(scene, {"type": "bdpt", "max_depth": 4, **keys}, 128)
    keys = {key: value for key, value in keys.items() if key != "heuristic"}
    assert_equal_means(ours, images(scene, {"type": "volpath", "max_depth": 4, **keys}, 512, 100), 8, where)


@slow
def test_strategies_agree() -> None:
    """Each of them alone, at paths of two edges: scattered once, at walls or in fog."""
    scene = lit_ball(fog(2.0, 0.8), wall={"type": "rectangle", "to_world": T().translate([0, 0, -2]).scale(4)})
    del scene["sky"]
    scene["lamp"] = {
        "type": "sphere",
        "center": [2.0, 2.0, 2.0],
        "radius": 0.7,
        "emitter": {"type": "area", "radiance": 5.0},
    }
    plugin = {"type": "bdpt", "max_depth": 2, "strategies": True}
    names = djpt.channel_names(djpt.load_dict(scene), integrator=djpt.load_dict(plugin))
    found = images(scene, plugin, 256)
    first = [names.index(f"s{s}t{3 - s}.alone.R") for s in range(3)]
    alone = [[image[..., k : k + 3] for image in found] for k in first]
    for other in (0, 2):
        assert alone[other][0].max() > 0
        assert_equal_means(alone[other], alone[1], block=8)


def test_no_derivatives_by_fog() -> None:
    loaded = djpt.load_dict(foggy_room(fog(), size=4))
    params = djpt.traverse(loaded)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    with pytest.raises(RenderError, match="no derivatives in media that scatter light; 'prbvolpath' has"):
        djpt.render(loaded, integrator=djpt.load_dict({"type": "bdpt"}), spp=1)


def test_null_surfaces_alone_stay_as_for_path() -> None:
    """Without matter null surfaces are vertices, as for `path`, and hide light from connections."""
    scene = lit_ball(None, NULL, size=8)
    ours = images(scene, {"type": "bdpt", "max_depth": 3}, 16)
    assert_equal_means(ours, images(scene, {"type": "path", "max_depth": 3}, 16, 100))
