"""Rounds: the parts that a render which can go on at any time consists of.

A round is the image of `render` with a number of samples per pixel that all rounds of a render share, and with a seed
of its own. So the first rounds of a long render are those of a short one. The streams of samplers depend on the count
that is asked for; rounds ask for the same one each, whatever the render is extended to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.display.progress import Progress
from djpt.integrators.base import Integrator
from djpt.kernels import begin_trace
from djpt.process.interruption import Interruption
from djpt.rendering import centres, make_job, render, require_still
from djpt.scene import Scene
from djpt.schedules.canvas import Summed
from djpt.schedules.choice import choose
from djpt.schedules.job import Job
from djpt.schedules.memory import check_memory

__all__ = ["RoundSums", "begin_round", "round_seed"]

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]


def round_seed(seed: int, number: int) -> int:
    """The seed of a round: ``(seed + mix(number)) mod 2^32``, with the finaliser of MurmurHash3 (A. Appleby) as `mix`.

    `mix` is a bijection with mix(0) = 0: round 0 has the seed itself, and no two of 2^32 rounds have the same one.
    """
    h = number & 0xFFFFFFFF
    h = (h ^ h >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    h = (h ^ h >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return (seed + (h ^ h >> 16)) & 0xFFFFFFFF


@dataclass(frozen=True)
class RoundSums:
    """The image of a round before it is divided by its weights."""

    sums: Floats | Doubles
    """Weighted sums, (channels, height, width)."""
    weights: Floats
    """Their weights, (height, width), or (1, 1) if all pixels have the same."""
    constant: Floats
    """The channels that come from the centres of pixels, the same in each round: (height, width, channels)."""


def begin_round(
    scene: Scene,
    sensor: Any,
    integrator: Integrator,
    seed: int,
    spp: int,
    schedule: str,
    progress: Progress | None,
    interruption: Interruption | None,
) -> Callable[[], RoundSums]:
    """Launch the kernels of a round; the result waits for them.

    Kernels run meanwhile, unless there is something to be told after each pass.
    """
    begin_trace()
    if type(integrator).render is not Integrator.render:
        return waiting_for_image(render(scene, None, sensor, integrator, seed, spp=spp), spp)
    require_still(scene)
    job = make_job(scene, sensor, integrator, seed, spp, 0, progress, interruption)
    how = choose(schedule, job)
    check_memory(job)
    with dr.suspend_grad():
        if job.channel_names() and not how.in_bands:
            return waiting_for_image(how.image(job), spp, job)
        summed = list(how.rows(job)) if job.channel_names() else []

    def result() -> RoundSums:
        return RoundSums(*sums_of_rows(job, summed), constant_of(job))

    return result


def waiting_for_image(image: Any, spp: int, job: Job | None = None) -> Callable[[], RoundSums]:
    """The sums of a round of which only the image is known: each sample has the weight 1."""

    def result() -> RoundSums:
        values = np.moveaxis(image.numpy(), 2, 0).astype(np.float64) * spp
        height, width = values.shape[1:]
        constant = np.zeros((height, width, 0), np.float32) if job is None else constant_of(job)
        return RoundSums(values, np.full((1, 1), spp, np.float32), constant)

    return result


def sums_of_rows(job: Job, summed: list[Summed]) -> tuple[Floats, Floats]:
    """The sums and the weights of the pixels of a film, without its border."""
    border, (width, height) = job.film.border, job.film.crop_size()
    sums = np.zeros((job.channel_count(), height, width), np.float32)
    weights = np.zeros((height, width) if job.film.filters else (1, 1), np.float32)
    for rows, weight in summed:
        top, end = max(rows.first_row, border), min(rows.first_row + rows.count, border + height)
        if end <= top:
            continue
        inside = slice(top - rows.first_row, end - rows.first_row), slice(border, border + width)
        target = slice(top - border, end - border)
        for channel, values in zip(sums, rows.sums, strict=False):
            channel[target] = values.numpy()[: rows.count * job.width].reshape(rows.count, job.width)[inside]
        if job.film.filters:
            weights[target] = weight.numpy()[: rows.count * job.width].reshape(rows.count, job.width)[inside]
        else:
            weights[...] = weight.numpy()
    return sums, weights


def constant_of(job: Job) -> Floats:
    """The channels of a job that come from the centres of its pixels."""
    width, height = job.film.crop_size()
    if not job.integrator.unfiltered_names():
        return np.zeros((height, width, 0), np.float32)
    return np.asarray(centres(job).numpy(), np.float32)
