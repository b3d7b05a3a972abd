"""Derivatives at the ends of the ranges of parameters: at 0 and hardly above, and at 1, against finite differences.

Every plugin that images have derivatives by is here, or is named with the reason why it isn't.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.description import registry
from tests.kit import emitters, materials
from tests.kit.derivatives import STEPS, ZEROS, Limits, differentiable
from tests.kit.lit_floor import floor_scene
from tests.kit.materials import ball, bitmap, checks, rgb, texels
from tests.kit.media_scenes import fog, lit_ball
from tests.kit.phases import PHASES, described

KINDS = ("bsdf", "emitter", "texture", "phase", "medium", "volume")

FAST = {"diffuse", "rgb", "area"}
"""The handful that is always tested."""

WITHOUT = {
    "null": "has no parameters",
    "isotropic": "has no parameters",
    "rayleigh": "has no parameters",
    "directionalarea": "paths never meet it: only light tracing sees it, which has no derivatives",
    "blackbody": "has no derivatives",
    "regular": "has no derivatives",
    "irregular": "has no derivatives",
    "measured": "has no derivatives",
}
"""Plugins that aren't taken to the ends of ranges, and why."""

EXCLUDED = {
    ("principled", "specular"): "the slope is infinite where light is refracted: see `test_vanishing_interfaces`",
    ("sggx", "S.data"): "a matrix of six equal numbers is singular",
}
"""The ends of the keys of parameters of plugins that aren't tested, and why."""

SMOOTHEST, CRITICAL = (1e-5,), (0.005, 1e-4)
STEPS_OF = {
    # Rougher than the smoothest surface that counts nothing is flat: below, all are the same.
    "alpha": SMOOTHEST, "alpha.value": SMOOTHEST, "alpha.data": SMOOTHEST, "roughness": SMOOTHEST,
    "roughness.value": SMOOTHEST,
    # Near the critical angle of a metal whose eta is less than 1 reflection stops being total like sqrt(k).
    "k.value": CRITICAL,
}  # fmt: skip
"""Steps from 0 for parameters whose effect there changes within less than `STEPS`, by the ends of their keys."""

COLOURED = {"dielectric": "dielectric-tinted", "thindielectric": "thindielectric-tinted", "glass": "dielectric-tinted"}
"""Sets of parameters with colours, where the first set of a plugin has none."""

Scene = Callable[[], tuple[dict[str, Any], str]]


def grid() -> dict[str, Any]:
    return {"type": "gridvolume", "data": djpt.TensorXf(texels(2, 2, 2, 3)), "raw": True}


TEXTURES: dict[str, Callable[[], Any]] = {
    "bitmap": lambda: bitmap(texels(3, 2, 3)),
    "checkerboard": lambda: checks(0.3, rgb(0.9, 0.5, 0.1)),
    "d65": lambda: {"type": "d65"},
    "rawconstant": lambda: {"type": "rawconstant", "value": 0.4},
    "rgb": lambda: rgb(0.4, 0.5, 0.6),
    "spectrum": lambda: {"type": "spectrum", "value": 0.4},
    "srgb": lambda: {"type": "srgb", "color": [0.4, 0.5, 0.6]},
    "uniform": lambda: {"type": "uniform", "value": 0.4},
    "volume": lambda: {"type": "volume", "volume": grid()},
}


def painted() -> djpt.Mesh:
    """A triangle with a colour for each corner."""
    texture = {"type": "mesh_attribute", "name": "vertex_color"}
    colours = {"vertex_color": [[0.2, 0.5, 0.9], [0.7, 0.4, 0.1], [1.0, 0.8, 0.6]]}
    bsdf = {"type": "diffuse", "reflectance": texture}
    return djpt.Mesh("ball", [[-1, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]], None, None, {"bsdf": bsdf}, colours)


def in_fog(medium: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """A medium in a ball under the sky and a lamp."""
    lamp = {"type": "sphere", "center": [-2, 3, 2.5], "radius": 0.5, "emitter": {"type": "area", "radiance": 8.0}}
    return lit_ball(medium, max_depth=8, size=8, lamp=lamp), "ball.interior_medium"


def scene_of(kind: str, plugin: str) -> tuple[dict[str, Any], str]:
    """A scene with the plugin, and what the keys of its parameters begin with."""
    if kind == "bsdf":
        name = COLOURED.get(plugin) or next(name for name in materials.NAMES if materials.plugin_of(name) == plugin)
        return ball(materials.bsdf(name) | {"type": plugin}, size=8), "ball.bsdf"
    if kind == "emitter":
        known = (emitters.entry(name) for name in emitters.NAMES if emitters.plugin_of(name) == plugin)
        entry = next(known, {"type": plugin})
        integrator = {"type": "path", "max_depth": 4}
        prefix = "light.emitter" if "emitter" in entry else "light"
        return floor_scene({"light": entry}, size=8, integrator=integrator), prefix
    if plugin == "mesh_attribute":
        return ball({}, size=8) | {"ball": painted()}, "ball.bsdf"
    if kind == "texture":
        return ball({"type": "diffuse", "reflectance": TEXTURES[plugin]()}, size=8), "ball.bsdf"
    if kind == "phase":
        name = next(name for name in PHASES if PHASES[name]["type"] == plugin)
        return in_fog(fog(1.0, 0.8, phase=described(name)))
    if plugin == "heterogeneous":
        return in_fog({"type": plugin, "sigma_t": grid(), "albedo": rgb(0.5, 0.7, 0.9), "scale": 2.0})
    albedo = {"constvolume": 0.7, "gridvolume": grid(), "homogeneous": rgb(0.5, 0.7, 0.9)}[plugin]
    return in_fog(fog(rgb(0.5, 1.0, 2.0) if kind == "medium" else 1.0, albedo))


def limits_of(description: dict[str, Any], prefix: str, spp: int = 512) -> Iterator[Limits]:
    """Each parameter whose key begins with the prefix."""
    scene = djpt.load_dict(description)
    return (Limits(scene, key, spp) for key in differentiable(djpt.traverse(scene), prefix))


CASES = [
    pytest.param(kind, plugin, id=f"{kind}-{plugin}", marks=() if plugin in FAST else pytest.mark.slow)
    for kind in KINDS
    for plugin, factory in sorted(registry.registered(kind).items())
    if registry.is_own(factory) and plugin not in WITHOUT
]


@pytest.mark.parametrize(("kind", "plugin"), CASES)
@pytest.mark.sparse(12)
def test_ends_of_ranges(kind: str, plugin: str) -> None:
    verdicts = []
    for limits in limits_of(*scene_of(kind, plugin), spp=4096 if plugin == "heterogeneous" else 512):
        (key,) = limits.keys
        if not any(key.endswith(end) for name, end in EXCLUDED if name == plugin):
            steps = next((steps for end, steps in STEPS_OF.items() if key.endswith(f".{end}")), STEPS)
            verdicts += limits.verdicts(steps=steps)
    print(plugin, *(text for _, text in verdicts), sep="\n  ")
    assert verdicts
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@pytest.mark.slow
def test_wrong_derivatives_fail() -> None:
    """The test's power."""
    (limits,) = limits_of(*scene_of("bsdf", "diffuse"))
    assert not any(good for good, _ in limits.verdicts(scale=1.1))


def test_excluded_plugins_exist() -> None:
    assert set(WITHOUT) | {name for name, _ in EXCLUDED} <= {
        name for kind in KINDS for name in registry.registered(kind)
    }


@pytest.mark.slow
@pytest.mark.parametrize("roughness", [0.5, 1.0])
def test_vanishing_interfaces(roughness: float) -> None:
    """Without refraction the slope by `specular` is finite at 0.

    Of the reflectance it is at most 0.08 / cos^4, since eta - 1 is about sqrt(0.32 specular). So directions along a
    surface count most, and where their reflectance nears 1 the slope falls: differences come close to it like the
    fourth root of the step. Rough surfaces have fewer such directions.
    """
    scene = ball({"type": "principled", "roughness": roughness}, size=8)
    (limits,) = limits_of(scene, "ball.bsdf.specular", spp=2048)
    verdicts = limits.verdicts(steps=(1e-4, 1e-5, 1e-6))
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)
    assert not any(good for good, _ in limits.verdicts(scale=2.0, steps=(1e-4, 1e-5)))


@pytest.mark.slow
def test_refraction_at_vanishing_interfaces() -> None:
    """Below a `specular` of 0.001 derivatives of refracted light are those at 0.001."""
    material = {"type": "principled", "spec_trans": 0.6, "roughness": 0.5}
    (limits,) = limits_of(ball(material, size=8), "ball.bsdf.specular")
    expected, error = limits.by_ad(1e-3)
    assert np.isfinite(expected) and error > 0
    for at in (*ZEROS, 1e-4):
        assert limits.by_ad(at)[0] == pytest.approx(expected, rel=1e-3)


def test_lights_that_are_black() -> None:
    """Emitters that shine with 0 are sampled as ever, and shadows fall on what they would light."""
    limits = Limits(djpt.load_dict(scene_of("emitter", "area")[0]), "light.emitter.radiance.value")
    slope, error = limits.by_differences(0.0, 0.5)
    found, noise = limits.by_ad(0.0)
    assert abs(found - slope) < max(0.02 * slope, 4 * float(np.hypot(error, noise)))
