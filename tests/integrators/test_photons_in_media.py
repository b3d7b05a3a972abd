"""`sppm` and `vcm` among media that scatter light: closed forms, the means of `volpath`, what they refuse."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError
from tests.integrators.test_bdpt_media import SCENES, without_lamps
from tests.integrators.test_photon_mapping import MERGING
from tests.kit.convergence import assert_equal_means, images
from tests.kit.media_scenes import colour, fog, foggy_room, lit_ball
from tests.kit.phases import described
from tests.kit.threads import assert_same_for_any_threads

KINDS = ("sppm", "vcm")
slow = pytest.mark.slow


def image(scene: dict[str, Any], integrator: dict[str, Any], spp: int, seed: int = 0) -> np.ndarray:
    loaded, plugin = djpt.load_dict(scene), djpt.load_dict(integrator)
    return np.array(djpt.render(loaded, integrator=plugin, spp=spp, seed=seed), np.float64)


# ---------------------------------------------------------------- closed forms


NEAR_CLIP = 0.01
"""Where the rays of a camera begin."""


def beam_in_fog(medium: dict[str, Any]) -> dict[str, Any]:
    """A beam of light of the width 1 that runs upwards through fog without end, seen from the side, 3 away."""
    return {
        "type": "scene",
        "lamp": {
            "type": "rectangle",
            "to_world": T().scale(0.5),
            "emitter": {"type": "directionalarea", "radiance": 2.0},
        },
        "sensor": {
            "type": "orthographic",
            "to_world": T().look_at(origin=[0, -3, 0.5], target=[0, 0, 0.5], up=[0, 0, 1]).scale([0.3, 0.3, 1]),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            "medium": medium,
        },
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "sigma_t", [(0.8, 0.8, 0.8), pytest.param((0.3, 0.8, 1.5), marks=slow)], ids=("grey", "coloured")
)
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_beam_scattered_once(kind: str, sigma_t: tuple[float, ...]) -> None:
    """The light of a beam on its way up, scattered to the side, and what the fog on both ways leaves of it."""
    scene = beam_in_fog(fog(colour(*sigma_t), colour(0.9, 0.5, 0.2)))
    plugin = {"type": kind, "max_depth": 2, "initial_radius": 0.05, "photon_count": 2**15, **MERGING[kind]}
    each = np.stack([found.mean(axis=1) for found in images(scene, plugin, 512)])
    sigma = np.array(sigma_t)
    height = 0.2 + 0.6 * (np.arange(8)[::-1, None] + 0.5) / 8
    irradiance, through = 2.0 * np.exp(-sigma * height), (1 - np.exp(-sigma)) * np.exp(-(2.5 - NEAR_CLIP) * sigma)
    expected = np.array([0.9, 0.5, 0.2]) / (4 * math.pi) * irradiance * through
    rows, inner = each.mean(axis=0), each[:, 2:6].mean(axis=1)
    error = inner.std(axis=0, ddof=1) / math.sqrt(len(inner))
    assert (error < 0.02 * expected[2:6].mean(axis=0)).all()
    assert (np.abs(inner.mean(axis=0) - expected[2:6].mean(axis=0)) < 4 * error).all()
    # Down and up the light falls off, not at random.
    assert (rows[0] < rows[-1]).all()


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=() if kind == "sppm" else slow) for kind in KINDS])
def test_furnace(kind: str) -> None:
    """Fog that absorbs nothing is as bright as the sky about it."""
    scene = lit_ball(fog(2.0, 1.0), size=8)
    found = image(scene, {"type": kind, "initial_radius": 0.1, "photon_count": 2**14, "rr_depth": 50}, 512)
    assert found.mean() == pytest.approx(1, rel=0.01)


# ---------------------------------------------------------------- the means of `volpath`

REFUSED = {("sppm", "glowing")}


@slow
@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind in KINDS for name in SCENES if (kind, name) not in REFUSED],
)
def test_scenes(kind: str, name: str) -> None:
    scene = SCENES[name]()
    where = without_lamps(scene)
    plugin = {"type": kind, "max_depth": 4, "initial_radius": 0.02, "photon_count": 2**13, **MERGING[kind]}
    ours = images(scene, plugin, 32)
    assert_equal_means(ours, images(scene, {"type": "volpath", "max_depth": 4}, 512, 100), 8, where)


@slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_vanish_with_the_radius(kind: str) -> None:
    """Three radii: what they are wrong by falls at least in proportion."""
    scene = foggy_room(fog(3.0, 0.8, phase={"type": "hg", "g": 0.5}))
    where = without_lamps(scene)
    true = np.stack(images(scene, {"type": "volpath", "max_depth": 4}, 2048, 100)) * where
    errors = []
    for radius in (0.16, 0.08, 0.04):
        plugin = {"type": kind, "max_depth": 4, "initial_radius": radius, "alpha": 1.0, "photon_count": 2**13}
        plugin.update(MERGING[kind])
        wrong = np.stack(images(scene, plugin, 256)) * where - true
        # The product of two independent differences has no noise in its mean.
        squared = (wrong[::2].mean(axis=0) * wrong[1::2].mean(axis=0)).mean()
        errors.append(np.sqrt(max(squared, 0)) / true.mean())
    assert errors[1] < 0.75 * errors[0] and errors[2] < 0.75 * 0.75 * errors[0]
    assert errors[2] < 0.03


# ---------------------------------------------------------------- contracts


@slow
@pytest.mark.parametrize("kind", KINDS)
def test_image_is_the_same_for_any_threads_and_passes(kind: str) -> None:
    scene = djpt.load_dict(foggy_room(fog(1.0, 0.8), size=8))
    plugin = djpt.load_dict({"type": kind, "max_depth": 4, "photon_count": 500, "initial_radius": 0.1})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=6, seed=4, **arguments))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=3), first)


@pytest.mark.parametrize(
    ("kind", "medium", "problem"),
    [
        ("sppm", fog(emission=1.0), "no photons of media that glow"),
        *((kind, fog(phase=described("sheets")), "the same in all directions") for kind in KINDS),
    ],
)
def test_what_is_refused(kind: str, medium: dict[str, Any], problem: str) -> None:
    with pytest.raises(RenderError, match=problem):
        image(foggy_room(medium, size=4), {"type": kind}, 1)
