"""Derivatives at the ends of the ranges of parameters: at 0 and hardly above, and at 1, against finite differences.

Every plugin that images have derivatives by is here, or is named with the reason why it isn't.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.description import registry
from tests.kit import emitters, materials
from tests.kit.limits import Limits
from tests.kit.lit_floor import floor_scene
from tests.kit.material_ball import ball
from tests.kit.materials import bitmap, checks, rgb, texels
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
    "heterogeneous": "has no derivatives: its extinction is sampled",
    "blackbody": "has no derivatives",
    "regular": "has no derivatives",
    "irregular": "has no derivatives",
    "mesh_attribute": "its values are those of a mesh",
    "measured": "has no derivatives",
    "timed_sunsky": "a sunsky for each of its times",
    "glass": "has no derivatives",
    "sggx": "an ellipsoid of facets whose numbers are all the same is singular",
}
"""Plugins that aren't taken to the ends of ranges, and why."""

EXCLUDED = {
    "alpha": "the smallest roughness of a material is more than 0: the derivative below it is 0",
    "roughness": "as alpha",
    "alpha.data": "as alpha",
    "specular": "light is refracted by ever thinner lobes as the interface vanishes, and noise grows beyond all bounds",
    "k.value": "at the critical angle of a metal without absorption the slope is infinite",
    "sun_direction": "isn't a number",
    "scale_tilt": "isn't in a range from 0",
    "delta.value": "an angle",
    "theta.value": "an angle",
    "cutoff_angle": "an angle, whose effect at 0 has no slope",
    "beam_width": "an angle",
    "nested_texture.data": "a map of one height or one normal has no slope in the direction of all its texels",
    "normalmap.data": "as the map of heights",
    "values": "all values of a table at once don't change its shape",
}
"""The ends of the keys of parameters that aren't tested, and why."""

COLOURED = {"dielectric": "dielectric-tinted", "thindielectric": "thindielectric-tinted"}
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


def in_fog(medium: dict[str, Any]) -> tuple[dict[str, Any], str]:
    """A medium in a ball under the sky and a lamp."""
    lamp = {"type": "sphere", "center": [-2, 3, 2.5], "radius": 0.5, "emitter": {"type": "area", "radiance": 8.0}}
    return lit_ball(medium, max_depth=8, size=8, lamp=lamp), "ball.interior_medium"


def scene_of(kind: str, plugin: str) -> tuple[dict[str, Any], str]:
    """A scene with the plugin, and what the keys of its parameters begin with."""
    if kind == "bsdf":
        name = COLOURED.get(plugin) or next(name for name in materials.NAMES if materials.plugin_of(name) == plugin)
        return ball(materials.bsdf(name), size=8), "ball.bsdf"
    if kind == "emitter":
        entry = emitters.entry(next(name for name in emitters.NAMES if emitters.plugin_of(name) == plugin))
        integrator = {"type": "path", "max_depth": 4}
        prefix = "light.emitter" if "emitter" in entry else "light"
        return floor_scene({"light": entry}, size=8, integrator=integrator), prefix
    if kind == "texture":
        return ball({"type": "diffuse", "reflectance": TEXTURES[plugin]()}, size=8), "ball.bsdf"
    if kind == "phase":
        name = next(name for name in PHASES if PHASES[name]["type"] == plugin)
        return in_fog(fog(1.0, 0.8, phase=described(name)))
    albedo = {"constvolume": 0.7, "gridvolume": grid(), "homogeneous": rgb(0.5, 0.7, 0.9)}[plugin]
    return in_fog(fog(rgb(0.5, 1.0, 2.0) if kind == "medium" else 1.0, albedo))


CASES = [
    pytest.param(kind, plugin, id=f"{kind}-{plugin}", marks=() if plugin in FAST else pytest.mark.slow)
    for kind in KINDS
    for plugin, factory in sorted(registry.registered(kind).items())
    if registry.is_own(factory) and plugin not in WITHOUT
]


@pytest.mark.parametrize(("kind", "plugin"), CASES)
def test_ends_of_ranges(kind: str, plugin: str) -> None:
    limits = Limits(*scene_of(kind, plugin))
    keys = [key for key in limits.keys if not key.endswith(tuple(EXCLUDED))]
    verdicts = [verdict for key in keys for verdict in limits.verdicts(key)]
    print(plugin, *(text for _, text in verdicts), sep="\n  ")
    assert verdicts
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


def test_wrong_derivatives_fail() -> None:
    """The test's power."""
    limits = Limits(*scene_of("bsdf", "diffuse"))
    (key,) = limits.keys
    assert not any(good for good, _ in limits.verdicts(key, scale=1.1))


def test_excluded_plugins_exist() -> None:
    assert set(WITHOUT) <= {name for kind in KINDS for name in registry.registered(kind)}


def test_lights_that_are_black() -> None:
    """Emitters that shine with 0 are sampled as ever, and shadows fall on what they would light."""
    limits = Limits(*scene_of("emitter", "area"))
    slope, error = limits.difference("light.emitter.radiance.value", 0.0, 0.5)
    found, noise = limits.reverse("light.emitter.radiance.value", 0.0)
    assert abs(found - slope) < max(0.02 * slope, 4 * float(np.hypot(error, noise)))
