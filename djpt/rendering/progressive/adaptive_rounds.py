"""Rounds over tiles: the kernels of adaptive renders."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.process.interruption import Interruption
from djpt.description.registry import name_of, registered
from djpt.errors import RenderError, near_miss
from djpt.integrators.base import Integrator
from djpt.jit.frozen import without_garbage
from djpt.jit.kernels import begin_trace, shared
from djpt.jit.llvm.results import Results
from djpt.jit.types import Float, UInt32
from djpt.rendering.gradients.leaves import attached_parameters
from djpt.rendering.image import make_job, require_still
from djpt.rendering.progress import Progress
from djpt.rendering.progressive.adaptive import Counts, TileSums
from djpt.rendering.progressive.rounds import constant_of, inputs, round_seed
from djpt.rendering.progressive.tile_job import TileJob, film_sums, reason_against
from djpt.rendering.progressive.tiles import Tiles
from djpt.rendering.schedules.choice import choose
from djpt.rendering.schedules.job import Job
from djpt.rendering.schedules.memory import check_memory
from djpt.scene.scene import Scene
from djpt.sensors import Sensor

__all__ = ["AdaptiveRounds"]

Floats = npt.NDArray[np.float32]

PIXELS = 2**16
"""The pixels of the tiles that are computed at once: a film's sums are up to half a kilobyte for each."""

REPEATED = 2**20
"""The numbers of rounds end here; those of a tile that a round samples again follow."""


class AdaptiveRounds:
    """The rounds of one image over tiles.

    The samples of a tile in a round are those of `render` with the round's seed. If the round samples the tile again,
    they have the seed of a round that no render comes to.

    Raises:
        RenderError: The image can't be rendered in tiles.
    """

    def __init__(self, scene: Scene, sensor: Sensor, integrator: Integrator, spp: int, schedule: str) -> None:
        self._scene, self._sensor, self._integrator = scene, sensor, integrator
        self._spp, self._schedule = spp, schedule
        if type(integrator).render is not Integrator.render or "flat" not in integrator.schedules:
            able = (name for name, kind in registered("integrator").items() if "flat" in getattr(kind, "schedules", ()))
            name = name_of(type(integrator)) or type(integrator).__name__
            raise RenderError(f"the integrator '{name}' can't render adaptively{near_miss('', able)}")
        require_still(scene)
        job = self._job()
        check_memory(job)
        if not job.sampler.has_streams:
            raise RenderError(f"{job.sampler.id()} has no stream for each sample, which adaptive renders need")
        if choose(schedule, job).name == "machine":
            self._schedule = "flat"
        problem = reason_against(job, choose(self._schedule, job))
        if problem:
            raise RenderError(f"the render can't be adaptive: {problem}")
        border = job.film.border
        width, height = job.film.crop_size()
        grid = int(width) + 2 * border, int(height) + 2 * border
        self.tiles = Tiles(grid, border, job.film.taps // 2)
        self._filters, self._constant = job.film.filters, constant_of(job)
        self._inputs: list[Any] = []
        self._recorded: dict[int, Callable[..., list[Float]]] | None = None
        if integrator.is_pure() and not attached_parameters(job.scene):
            self._recorded = {}

    @property
    def _together(self) -> int:
        """The tiles that are computed at once."""
        return max(1, PIXELS // (self.tiles.width * self.tiles.height))

    @property
    def small(self) -> bool:
        """Whether all tiles are computed at once."""
        return self.tiles.count <= self._together

    def _job(self) -> Job:
        begin_trace()
        return make_job(self._scene, self._sensor, self._integrator, 0, self._spp)

    def begin(
        self, seed: int, number: int, places: Counts, progress: Progress | None, interruption: Interruption | None
    ) -> Callable[[], TileSums]:
        """Launch the kernels of a round that samples the tiles `places`, in order; the result waits for them."""
        _, first = np.unique(places, return_index=True)
        again = np.arange(len(places)) - np.repeat(first, np.diff(first, append=len(places)))
        seeds = [round_seed(seed, number + REPEATED * k) for k in again.tolist()]
        size, parts = self._together, []
        for start in range(0, len(places), size):
            parts.append(self._launch(places[start : start + size], seeds[start : start + size]))
            if interruption is not None or progress is not None or start >= 2 * size:
                # Never far ahead of the kernels: what all of them need must not pile up in memory.
                dr.sync_thread()
            if interruption is not None:
                interruption.check()
            if progress is not None:
                progress(start + len(places[start : start + size]), len(places))

        results = Results()

        def result() -> TileSums:
            films = [self._on_host(part, results) for part in parts]
            parts.clear()
            if len(films) > 1:
                # What kernels took is needed for sums of 64 bits.
                dr.flush_malloc_cache()
            return TileSums(places, films, self._constant)

        return result

    def _launch(self, places: Counts, seeds: list[int]) -> list[Float]:
        """Launch the kernels of some tiles."""
        begin_trace()
        count = len(seeds)
        numbers = [copied(np.array(values, np.uint32)) for values in (places, seeds)]
        with dr.suspend_grad():
            if self._recorded is None:
                return self._films([], *numbers)
            if count not in self._recorded:
                # The first time they are only traced: what kernels call is compiled then.
                self._recorded[count] = dr.freeze(self._films, auto_opaque=False)
                films = self._films([], *numbers)
                self._inputs = inputs(self._scene, self._sensor, self._integrator)
                return films
            with without_garbage():
                return self._recorded[count](self._inputs, *numbers)

    def _films(self, inputs: list[Any], places: UInt32, seeds: UInt32) -> Any:
        """The films of some tiles by `tile_job.film_sums`; `inputs` is what their kernels read."""
        with dr.suspend_grad():
            job = make_job(self._scene, self._sensor, self._integrator, 0, self._spp)
            tiles = TileJob.of(job, self.tiles, places, seeds)
            return film_sums(tiles, choose(self._schedule, tiles))

    def _on_host(self, part: list[Float], results: Results) -> list[Floats]:
        """The films of some tiles: for each channel, the last being the weight, (tiles, height, width)."""
        films = [results.numpy(sums).reshape(-1, *self.tiles.film) for sums in part]
        return films if self._filters else [*films, np.broadcast_to(np.float32(self._spp), films[0].shape)]


def copied(numbers: npt.NDArray[np.uint32]) -> UInt32:
    """A copy of an array in memory of Dr.Jit's own, which doesn't wait for kernels."""
    result = shared(numbers) ^ dr.opaque(UInt32, 0)
    dr.eval(result)
    return result
