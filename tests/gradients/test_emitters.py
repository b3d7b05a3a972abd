"""Gradients of an image by every parameter of every emitter, against finite differences with the same seed.

Where light is linear in a parameter both agree to rounding. Angles and texels of lights whose sampling follows
them move samples: both then have the same mean.
"""

from __future__ import annotations

import numpy as np
import pytest

import djpt
from tests.kit.derivatives import Slopes, differentiable, numbers
from tests.kit.emitters import NAMES, entry, first_of_each, plugin_of
from tests.kit.lit_floor import floor_scene

pytestmark = pytest.mark.cuda

JUMPS = {"spot-checkerboard": {"light.cutoff_angle"}}
"""The squares of a checkerboard grow with the cone, and derivatives don't see edges that move."""


class EmitterSlopes(Slopes):
    """By the parameters of a light over the floor."""

    def __init__(self, name: str, schedule: str = "auto") -> None:
        integrator = {"type": "prb", "max_depth": 4, "rr_depth": 1000}
        scene = djpt.load_dict(floor_scene({"light": entry(name)}, size=self.size, integrator=integrator))
        params, rng = djpt.traverse(scene), np.random.default_rng(3)
        # By the sun's direction only without a sun, as its edge is followed by a kernel that has an error.
        left_out = {"light.sun_direction" if entry(name).get("sun_scale", 1) else "light.sun_scale"}
        at, along = {}, {}
        # Of a shape that shines, what the emitter in it has.
        prefix = "light.emitter." if "emitter" in entry(name) else "light."
        for key in differentiable(params, prefix, JUMPS.get(name, set()) | left_out):
            value = numbers(params[key])
            # Off the ends of all ranges; angles in degrees have as much effect as other numbers by larger steps.
            degrees = key.endswith(("angle", "width"))
            at[key] = np.clip(value, 3, 80) * (0.8 if key.endswith("width") else 1) if degrees else value + 0.03
            along[key] = rng.uniform(0.5, 1, value.shape) * (10 if degrees else 1)
        super().__init__(scene, at, along, schedule)


SEEN = [name for name in NAMES if plugin_of(name) != "directionalarea"]


@pytest.mark.sparse(24)
@pytest.mark.parametrize("name", first_of_each(SEEN))
def test_every_parameter(name: str) -> None:
    slopes, exact = EmitterSlopes(name), {}
    assert slopes.keys
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)
    assert any(exact[1][key] for key in slopes.keys)


@pytest.mark.parametrize("name", ["directional-turned", "projector-bitmap", "spot-turned", "spot-bitmap"])
@pytest.mark.sparse(2)
def test_schedules_agree(name: str) -> None:
    """The same samples in another order."""
    flat, wave = (EmitterSlopes(name, schedule).slopes(1) for schedule in ("flat", "wave"))
    largest = max(map(abs, flat.values()))
    for key, slope in flat.items():
        assert wave[key] == pytest.approx(slope, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.sparse(6)
@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("directional-turned", "light.irradiance.value"),
        ("projector-colour", "light.scale"),
        ("projector-bitmap", "light.irradiance.data"),
        ("spot-turned", "light.cutoff_angle"),
        ("spot-turned", "light.beam_width"),
        ("spot-bitmap", "light.texture.data"),
    ],
)
def test_wrong_derivatives_fail(name: str, key: str) -> None:
    """The test's power."""
    assert not EmitterSlopes(name).check(key, {}, 1.05)[0]


def test_a_hidden_light_has_no_gradient() -> None:
    with pytest.warns(UserWarning, match="can't show light"):
        assert EmitterSlopes("directionalarea-rectangle").slopes(1) == {"light.emitter.radiance.value": 0.0}
