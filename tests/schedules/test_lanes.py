"""Lanes of one pixel that stand side by side: the same sums, in the same order; and work that packets skip."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFSample3f
from djpt.jit.kernels import computed_where
from djpt.jit.types import Bool, Color3f, Float, UInt32, Vector3f
from djpt.rendering.image import make_job
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Band
from djpt.rendering.schedules.lanes import lanes_per_pixel
from djpt.rendering.settings import RenderSettings
from tests.kit.renders import box, pixels

SIZE, SPP = 9, 32


@pytest.mark.parametrize(
    ("schedule", "integrator"),
    [
        ("flat", {"type": "path", "max_depth": 4}),
        ("wave", {"type": "direct"}),
        ("wave", {"type": "aov", "aovs": "n:sh_normal", "a": {"type": "direct"}}),
    ],
)
def test_sums_are_those_of_each_lane_in_order(schedule: str, integrator: dict[str, Any]) -> None:
    scene = djpt.load_dict(box(SIZE, "box", integrator))
    job = make_job(scene, RenderSettings.of(scene, seed=3, spp=SPP))
    lanes, how = lanes_per_pixel(SIZE * SIZE, SPP), choose(schedule, job)
    assert lanes > 1
    channels = [np.array(c) for c in how.samples(job, Band(0, SIZE), 0, SPP)]
    samples = np.array(channels).reshape(len(channels), SPP, -1)
    expected = np.zeros_like(samples[:, 0])
    for g in range(lanes):
        of_lane = np.zeros_like(expected)
        for k in range(g, SPP, lanes):
            of_lane += samples[:, k]
        expected += of_lane
    image = pixels(djpt.render(scene, seed=3, spp=SPP, schedule=schedule))
    np.testing.assert_allclose(image.reshape(SIZE * SIZE, -1), (expected * np.float32(1 / SPP)).T, rtol=0, atol=0)


def test_what_is_not_computed_is_zero() -> None:
    lane = dr.arange(UInt32, 40)
    wanted = (lane % 3 == 0) & (lane > 20)

    def work() -> tuple[BSDFSample3f, list[Float], Color3f]:
        bs = dr.zeros(BSDFSample3f)
        bs.wo, bs.pdf, bs.sampled_type = Vector3f(Float(lane), 1, 2), Float(lane) + 0.5, lane
        return bs, [Float(lane)], Color3f(3)

    bs, (value,), color = computed_where(wanted, work, label="test")
    here = np.array(wanted)
    np.testing.assert_array_equal(np.array(bs.wo)[0], np.where(here, np.arange(40), 0))
    np.testing.assert_array_equal(np.array(bs.pdf), np.where(here, np.arange(40) + 0.5, 0))
    np.testing.assert_array_equal(np.array(bs.sampled_type), np.where(here, np.arange(40), 0))
    np.testing.assert_array_equal(np.array(value), np.where(here, np.arange(40), 0))
    np.testing.assert_array_equal(np.array(color)[2], np.where(here, 3, 0))
    nothing = computed_where(Bool(False) & wanted, lambda: (Float(lane),), label="test")
    assert not np.any(np.array(nothing[0]))
