"""Flights in fog of coloured extinction that draw a channel each."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from tests.kit.media_scenes import colour, fog, lit_ball

COUNT = 200_000
LENGTH = 0.7


def flights(
    sigma_t: tuple[float, ...], throughput: tuple[float, ...], channel: int | None = None
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Where light is scattered, and the values (3, COUNT), with the albedo 1; sampled by one channel, or by all."""
    medium, sampler = djpt.load_dict(fog(colour(*sigma_t), 1.0)), djpt.load_dict({"type": "independent"})
    sampler.seed(3, COUNT)
    ray = djpt.Ray3f([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    active = dr.full(djpt.Bool, True, COUNT)
    drawing = None if channel is None else djpt.UInt32(channel)
    flight = medium.fly(ray, djpt.Float(LENGTH), drawing, djpt.Color3f(*throughput), sampler, active)
    values = flight.value * dr.rcp(flight.pdf if channel is None else flight.pdf[channel])
    return np.array(flight.scattered), np.stack([np.broadcast_to(np.array(x), COUNT) for x in values])


@pytest.mark.parametrize("throughput", [(1.0, 1.0, 1.0), (0.2, 1.0, 0.01)], ids=["white", "green"])
@pytest.mark.parametrize("sigma_t", [(0.5, 2.0, 4.0), (0.0, 3.0, 3.0)], ids=["dense", "clear in red"])
def test_light_that_passes_and_is_scattered(sigma_t: tuple[float, ...], throughput: tuple[float, ...]) -> None:
    """The share exp(-sigma_t d) passes, all else is scattered."""
    scattered, values = flights(sigma_t, throughput)
    passed = np.exp(-LENGTH * np.array(sigma_t))
    for share, found in ((passed, values * ~scattered), (1 - passed, values * scattered)):
        error = found.std(axis=1) / np.sqrt(COUNT)
        assert (np.abs(found.mean(axis=1) - share) <= 4 * error + 1e-6).all()


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize("sigma_t", [(0.5, 1.0, 2.0), (0.0, 1.0, 2.0)], ids=["dense", "clear in red"])
def test_each_channel_finds_what_scatters_in_the_others(sigma_t: tuple[float, ...], channel: int) -> None:
    scattered, values = flights(sigma_t, (1.0, 1.0, 1.0), channel)
    passed = np.exp(-LENGTH * np.array(sigma_t))
    for share, found in ((passed, values * ~scattered), (1 - passed, values * scattered)):
        error = found.std(axis=1) / np.sqrt(COUNT)
        assert (np.abs(found.mean(axis=1) - share) <= 4 * error + 1e-6).all()


def test_no_channel_outgrows_the_others() -> None:
    """The sum of the throughput, weighed by the importance of each channel, is the same after any flight."""
    sigma_t, throughput = np.array([0.5, 2.0, 4.0]), np.array([0.2, 1.0, 0.3])
    _, values = flights((0.5, 2.0, 4.0), (0.2, 1.0, 0.3))
    importance = throughput * (sigma_t + sigma_t.mean())
    np.testing.assert_allclose(importance @ values, importance.sum(), rtol=1e-4)


@pytest.mark.parametrize("throughput", [(1.0, 1.0, 1.0), (0.0, 0.0, 0.0)], ids=["white", "black"])
@pytest.mark.parametrize("sigma_t", [(0.0, 0.0, 0.0), (1e-12, 0.0, 1e12)], ids=["clear", "extreme"])
def test_values_are_finite(sigma_t: tuple[float, ...], throughput: tuple[float, ...]) -> None:
    scattered, values = flights(sigma_t, throughput)
    assert np.isfinite(values).all() and (values >= 0).all()
    if not any(sigma_t):
        np.testing.assert_array_equal(values, 1)
        assert not scattered.any()


def test_the_first_channel_counts_where_extinction_is_said_to_be_grey() -> None:
    """In flights, in shadows and in derivatives."""
    found = []
    for sigma_t, spectral in ((colour(0.5, 1, 2), False), (0.5, True)):
        medium = fog(sigma_t, 0.8, has_spectral_extinction=spectral)
        lamp = {"type": "point", "position": [2, 2, 2], "intensity": 20.0}
        scene = djpt.load_dict(lit_ball(medium, max_depth=4, size=8, lamp=lamp))
        params = djpt.traverse(scene)
        dr.enable_grad(params["ball.interior_medium.scale"])
        params.update()
        image = djpt.render(scene, params, spp=16)
        dr.set_grad(params["ball.interior_medium.scale"], 1.0)
        found.append((np.array(dr.forward_to(image)), np.array(image)))
    for one, other in zip(*found, strict=True):
        assert np.ptp(other) > 0.01
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)
