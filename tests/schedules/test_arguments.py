"""Numbers that don't fit into what kernels count with, and arguments of other types."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.rendering.settings import RenderSettings


@pytest.fixture(scope="module")
def scene() -> Any:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=4, height=4)
    return djpt.load_dict(description)


@pytest.mark.parametrize("key", ["max_depth", "rr_depth"])
@pytest.mark.parametrize("value", [2**32, 2**70], ids=repr)
def test_depths_of_more_than_32_bits(key: str, value: int) -> None:
    with pytest.raises(djpt.SceneError, match=f"'{key}' must fit into 32 bits, found int {value}"):
        djpt.load_dict({"type": "path", key: value})


def test_sample_counts_that_are_rounded_up_to_too_many() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=1, height=1)
    description["sensor"]["sampler"] = {"type": "stratified", "sample_count": 2**32 - 1}
    with pytest.raises(djpt.RenderError, match=r"more than 2\^32 samples"):
        djpt.render(djpt.load_dict(description))


@pytest.mark.parametrize("arguments", [{"spp": 2**32}, {"progress": 5}, {"integrator": djpt.UInt32([1, 2])}], ids=str)
def test_arguments_that_nothing_can_be_done_with(scene: Any, arguments: dict[str, Any]) -> None:
    with pytest.raises(djpt.RenderError, match=next(iter(arguments))):
        djpt.render(scene, **{"spp": 1, **arguments})


def test_settings_are_checked_once_and_varied_by_replacing(scene: Any) -> None:
    settings = RenderSettings.of(scene, seed=7, spp=np.int64(3))
    assert (settings.sensor, settings.integrator) == (scene.sensors()[0], scene.integrator())
    assert (settings.seed, settings.spp) == (7, 3) and type(settings.spp) is int
    with pytest.raises(FrozenInstanceError):
        settings.spp = 4  # type: ignore[misc]
    assert replace(settings, spp=0).sample_count == scene.sensors()[0].sampler().sample_count()


def test_settings_count_samples_as_the_sampler_does(scene: Any) -> None:
    sensor = djpt.load_dict({"type": "perspective", "sampler": {"type": "stratified"}})
    assert RenderSettings.of(scene, sensor, spp=5).sample_count == 9


def test_seeds_of_gradients(scene: Any) -> None:
    """By default derived from the seed of the image, which None takes itself."""
    seeds = [RenderSettings.of(scene, seed=7, seed_grad=number).gradient_seed for number in (0, 5, None)]
    assert seeds[1:] == [5, 7] and seeds[0] not in (0, 5, 7)
