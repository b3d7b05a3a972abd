"""`upbp`: the grid of its beams, closed forms of each estimator, the means of `volpath`, `vcm` without media."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.errors import RenderError
from djpt.integrators.photons.cells import Box, Cells, Segment
from djpt.integrators.upbp import Crossing
from djpt.jit.types import Bool, Float, Point3f, UInt32
from tests.integrators.test_bdpt_media import SCENES, without_lamps
from tests.integrators.test_photons_in_media import NEAR_CLIP, beam_in_fog
from tests.kit.convergence import assert_equal_means, images
from tests.kit.media_scenes import colour, fog, foggy_room
from tests.kit.threads import assert_same_for_any_threads

slow = pytest.mark.slow

EVERYWHERE: dict[str, Any] = {"merging": "everywhere", "beam_count": 2**11}
"""Settings with which mergings find the light that connections would."""

ALONE: dict[str, dict[str, Any]] = {
    name: {**EVERYWHERE, **{key: key == name for key in ("points", "beams_of_camera", "beams_of_light")}}
    for name in ("points", "beams_of_camera", "beams_of_light")
}
"""The settings with one estimator besides connections."""


# ---------------------------------------------------------------- the grid


def vectors(values: np.ndarray) -> Point3f:
    """Vectors of Dr.Jit from an array (n, 3)."""
    return Point3f(*(Float(np.ascontiguousarray(c)) + 0 for c in values.T.astype(np.float32)))


def random_segments(count: int, spread: float, length: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, unit directions, some of them along axes, and lengths."""
    rng = np.random.default_rng(seed)
    o, d = rng.uniform(-spread, spread, (count, 3)), rng.normal(size=(count, 3))
    d[:20] = np.eye(3)[rng.integers(0, 3, 20)] * rng.choice([-1, 1], (20, 1))
    return (
        o,
        d / np.linalg.norm(d, axis=1, keepdims=True),
        rng.exponential(length, count) if length else np.zeros(count),
    )


@pytest.mark.parametrize("length", [0.0, 0.5], ids=["balls", "capsules"])
@pytest.mark.parametrize("radius", [0.03, 0.2])
@pytest.mark.sparse(2)
def test_grid_finds_what_rays_meet(length: float, radius: float) -> None:
    """Each ball and capsule once, where the nearest point of the ray is in the box, as brute force does."""
    count, rays, low, high = 2000, 300, np.array([-1, -1, -0.5]), np.array([1, 1, 0.5])
    o, d, lengths = random_segments(count, 1.1, length, 0)
    ro, rd, reach = random_segments(rays, 1.5, 3.0, 1)
    origin, direction, long = vectors(o), vectors(d), Float(lengths.astype(np.float32)) + 0
    ray, limit = Ray3f(vectors(ro), vectors(rd)), Float(reach.astype(np.float32)) + 0
    dr.eval(origin, direction, long)
    cells = Cells(Box.of(low, high), dr.opaque(Float, radius))

    def of(i: UInt32, there: Bool | bool = True) -> Segment:
        return Segment(*(dr.gather(type(a), a, i, there) for a in (origin, direction, long)))

    def nearest(i: UInt32, there: Bool) -> tuple[Float, Float, Bool]:
        """The distance along a ray, the squared distance from it, and whether the segment reaches so far."""
        at = of(i, there)
        if not length:
            t = dr.dot(at.o - ray.o, ray.d)
            return t, dr.squared_norm(at.o - ray(t)), Bool(True)
        crossing = Crossing.of(ray, at)
        return crossing.t, crossing.squared_distance, (crossing.s >= 0) & (crossing.s < at.length)

    def meets(i: UInt32, there: Bool, start: Float, end: Float) -> Bool:
        t, squared, fits = nearest(i, there)
        return there & fits & (squared <= radius**2) & (t >= start) & (t < end)

    cells.fill(count, of)
    found = cells.meet(
        ray, limit, Bool(True), meets, lambda i, there, n: n + dr.select(there, i + 1, 0), dr.zeros(UInt32, rays)
    )
    to = o[None] - ro[:, None]
    if length:
        cos = rd @ d.T
        along, back = (to * rd[:, None]).sum(-1), (to * d[None]).sum(-1)
        t, s = (along - cos * back) / (1 - cos**2), (cos * along - back) / (1 - cos**2)
    else:
        t, s = (to * rd[:, None]).sum(-1), np.zeros(to.shape[:2])
    there = ro[:, None] + t[..., None] * rd[:, None]
    near = np.linalg.norm(there - o[None] - s[..., None] * d[None], axis=-1) <= radius
    near &= ((there >= low) & (there <= high)).all(-1) & (t >= 0) & (t < reach[:, None])
    near &= (s >= 0) & (s <= lengths[None])
    expected = (near * (np.arange(count) + 1)).sum(1)
    assert near.sum() > 20
    wrong = np.array(found) != expected
    assert wrong.mean() < 0.01  # rounding decides where a ray just touches


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize(
    ("keys", "sigma_t"),
    [
        (EVERYWHERE, (0.8, 0.8, 0.8)),
        ({}, (0.3, 0.8, 1.5)),
        (EVERYWHERE, (0.3, 0.8, 1.5)),
        ({**EVERYWHERE, "long_beams": True}, (0.3, 0.8, 1.5)),
        *((keys, (0.3, 0.8, 1.5)) for keys in ALONE.values()),
    ],
    ids=str,
)
@pytest.mark.slow
def test_beam_scattered_once(keys: dict[str, Any], sigma_t: tuple[float, ...]) -> None:
    """The light of a beam on its way up, scattered to the side, and what the fog on both ways leaves of it."""
    scene = beam_in_fog(fog(colour(*sigma_t), colour(0.9, 0.5, 0.2)))
    plugin = {"type": "upbp", "max_depth": 2, "initial_radius": 0.02, "photon_count": 2**15, **keys}
    inner = np.stack([found[:, 2:6].mean(axis=(0, 1)) for found in images(scene, plugin, 512)])
    sigma = np.array(sigma_t)
    height = 0.2 + 0.6 * (np.arange(8)[::-1, None] + 0.5) / 8
    irradiance, through = 2.0 * np.exp(-sigma * height), (1 - np.exp(-sigma)) * np.exp(-(2.5 - NEAR_CLIP) * sigma)
    expected = (np.array([0.9, 0.5, 0.2]) / (4 * math.pi) * irradiance * through).mean(axis=0)
    error = inner.std(axis=0, ddof=1) / math.sqrt(len(inner))
    assert (error < 0.03 * expected).all()
    assert (np.abs(inner.mean(axis=0) - expected) < 4 * error).all()


# ---------------------------------------------------------------- the means of `volpath`


@slow
@pytest.mark.parametrize("keys", [{}, EVERYWHERE], ids=["glossy", "everywhere"])
@pytest.mark.parametrize("name", [name for name in SCENES if name != "a window"])
def test_scenes(name: str, keys: dict[str, Any]) -> None:
    scene = SCENES[name]()
    where = without_lamps(scene)
    plugin = {"type": "upbp", "max_depth": 4, "initial_radius": 0.02, "photon_count": 2**13, **keys}
    ours = images(scene, plugin, 32)
    assert_equal_means(ours, images(scene, {"type": "volpath", "max_depth": 4}, 512, 100), 8, where)


@slow
@pytest.mark.parametrize("keys", [EVERYWHERE, *ALONE.values()], ids=str)
def test_errors_vanish_with_the_radius(keys: dict[str, Any]) -> None:
    """Three radii: what they are wrong by falls at least in proportion, or is less than the noise."""
    scene = foggy_room(fog(3.0, 0.8, phase={"type": "hg", "g": 0.5}))
    where = without_lamps(scene)
    true = np.stack(images(scene, {"type": "volpath", "max_depth": 4}, 2048, 100)) * where
    errors = []
    for radius in (0.16, 0.08, 0.04):
        plugin = {
            "type": "upbp",
            "max_depth": 4,
            "initial_radius": radius,
            "alpha": 1.0,
            "photon_count": 2**13,
            **keys,
            "beam_count": 2**10,
        }
        wrong = np.stack(images(scene, plugin, 64)) * where - true
        # The product of two independent differences has no noise in its mean.
        squared = (wrong[::2].mean(axis=0) * wrong[1::2].mean(axis=0)).mean()
        errors.append(np.sqrt(max(squared, 0)) / true.mean())
    small = 0.01
    assert errors[1] < max(small, 0.75 * errors[0]) and errors[2] < max(small, 0.75 * 0.75 * errors[0])
    assert errors[2] < 0.03


# ---------------------------------------------------------------- contracts


@slow
def test_without_media_it_is_vcm() -> None:
    scene = djpt.cornell_box()
    scene["sensor"]["film"].update(width=16, height=16)
    loaded = djpt.load_dict(scene)
    settings = {"max_depth": 4, "photon_count": 2**12}
    ours, theirs = (
        np.array(djpt.render(loaded, integrator=djpt.load_dict({"type": kind, **settings}), spp=4, seed=2))
        for kind in ("upbp", "vcm")
    )
    np.testing.assert_array_equal(ours, theirs)


@slow
def test_image_is_the_same_for_any_threads_and_passes() -> None:
    scene = djpt.load_dict(foggy_room(fog(1.0, 0.8), size=8))
    plugin = djpt.load_dict({"type": "upbp", "max_depth": 4, "photon_count": 500, "initial_radius": 0.1})

    def render(**arguments: Any) -> np.ndarray:
        return np.array(djpt.render(scene, integrator=plugin, spp=6, seed=4, **arguments))

    first = assert_same_for_any_threads(render)
    np.testing.assert_array_equal(render(pass_spp=3), first)


def smoke_of(channels: int) -> dict[str, Any]:
    """Smoke whose extinction has some channels."""
    grid = {"type": "gridvolume", "data": djpt.TensorXf(np.full((2, 2, 2, channels), 0.5, np.float32))}
    return {"type": "heterogeneous", "albedo": 0.8, "sigma_t": grid}


@pytest.mark.parametrize(
    ("medium", "keys", "problem"),
    [(smoke_of(3), {}, "an extinction for each channel"), (smoke_of(1), {"long_beams": True}, "no long beams")],
    ids=["coloured", "long"],
)
def test_what_is_refused(medium: dict[str, Any], keys: dict[str, bool], problem: str) -> None:
    loaded = djpt.load_dict(foggy_room(medium, size=4))
    with pytest.raises(RenderError, match=problem):
        djpt.render(loaded, integrator=djpt.load_dict({"type": "upbp", **keys}), spp=1)
