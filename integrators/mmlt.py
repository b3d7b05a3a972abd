"""Metropolis light transport with the strategies of bidirectional path tracing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import drjit as dr

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.errors import RenderError
from djpt.films.footprint import Splats
from djpt.integrators.base import refuse_scattering_media
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.bidirectional.single_strategy import SingleStrategy, numbers_drawn
from djpt.integrators.markov.chains import Bootstrap, MarkovChains
from djpt.integrators.path import Path
from djpt.integrators.paths.passes import PassIntegrator, Walks
from djpt.jit.frozen import recording
from djpt.jit.types import Color3f, Float, UInt32
from djpt.samplers.seeds import sample_tea_32
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["MultiplexedMetropolis"]

MAX_EDGES = 32
"""The most edges of a path."""

FEWEST_STEPS = 512
"""The fewest steps of a chain: rather than shorter ones there are fewer chains, down to `FEWEST_CHAINS`."""

FEWEST_CHAINS = 256

BOOTSTRAP = 2**16, 2**24
"""The bounds of the number of bootstrap samples, if there are as many as suit the image."""


class MultiplexedMetropolis(PassIntegrator):
    """Follows Markov chains of paths: where one has brought light, paths like it are tried.

    A sample is one path, of one length and by one strategy (s, t) of `bdpt`, with its weight against the others. Its
    random numbers are a point of a cube, in which chains move by small steps, and by large ones that don't depend on
    where they are. So chains dwell where much light is, in proportion to it; how much there is in all says a
    *bootstrap* of independent samples, at which the chains begin.

    Strong where `bdpt` is, and where paths that bring light are rare but have bright neighbours. Noise is in patches
    and not in pixels, since neighbouring samples are alike; and what is dark gets few of them. Light that comes
    straight from an emitter is found from the camera's side, as `path` with `max_depth` 1 finds it. Scattering media
    aren't followed, and frozen functions can't record it.

    Parameters: `max_depth` (edges of the longest path, 1 .. 32, default 8), `bootstrap_samples` (independent samples
    before the first step; default 0: a quarter as many as there are steps, 2^16 .. 2^24), `chains` (default 4096; fewer
    where they had less than 512 steps), `large_step_probability` (default 0.1), `sigma` (the largest distance of
    a number's small step, the smallest being 1/64 of it, default 0.03), `hide_emitters`, `emitter_choice` (`uniform`,
    default, or `power`). `spp` is the number of steps per pixel of the image.

    T. Hachisuka, A. Kaplanyan and C. Dachsbacher, "Multiplexed Metropolis Light Transport", 2014.
    """

    pure = True
    starts_at_lights = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", 8, low=1, high=MAX_EDGES)
        self.bootstrap_samples = props.integer("bootstrap_samples", 0, low=0, high=2**30)
        self.chains = props.integer("chains", 4096, low=1, high=2**20)
        self.large_step_probability = props.float("large_step_probability", 0.1, low=0.0, high=1.0)
        self.sigma = props.float("sigma", 0.03, low=0.0, high=0.5)
        self.emitter_choice = props.string("emitter_choice", "uniform", choices=("uniform", "power"))
        hide = {"hide_emitters": self.hide_emitters}
        self.bdpt = BidirectionalPath(Properties("bdpt", f"{props.node}.ends", hide))
        # For light that comes straight from an emitter.
        self.from_camera = Path(Properties("path", f"{props.node}.straight", {"max_depth": 1} | hide))

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        refuse_scattering_media("mmlt", scene)
        if recording():
            raise RenderError("'mmlt' reads the brightness of its first samples, which a frozen function can't record")
        super().check_scene(scene, sensor)

    def begin(self, walks: Walks) -> State:
        return State(self, walks)

    def add_pass(self, walks: Walks, state: State, begin: int, end: int) -> State:
        state.advance(walks, end)
        return state

    def color(self, walks: Walks, state: State) -> Color3f:
        return state.color()


class State:
    """State that passes hand on: the chains, and the sums of their light."""

    def __init__(self, integrator: MultiplexedMetropolis, walks: Walks) -> None:
        width, height = walks.film.crop_size()
        self._pixels = width * height
        self._total = walks.spp * self._pixels
        self._spp, self._steps, self._count = walks.spp, 0, 0
        self._large = dr.opaque(Float, integrator.large_step_probability)
        self._sigma = dr.opaque(Float, integrator.sigma)
        self._splats = Splats(walks.film, 1.0)
        self._chains: MarkovChains | None = None
        self._mean = 0.0
        if integrator.max_depth < 2:
            return
        self._count = min(integrator.chains, max(FEWEST_CHAINS, self._total // FEWEST_STEPS))
        strategy = SingleStrategy(integrator.bdpt, walks.scene, walks.camera, walks.ray_at)
        low, high = BOOTSTRAP
        samples = integrator.bootstrap_samples or min(max(low, self._total // 4), high)
        of_bootstrap, of_chains = sample_tea_32(walks.seed, UInt32(0xFFFFFFFF))
        bootstrap = Bootstrap(strategy, of_bootstrap, integrator.max_depth, samples)
        self._mean = bootstrap.mean
        if self._mean > 0:
            size = numbers_drawn(integrator.max_depth)
            self._chains = MarkovChains(strategy, bootstrap, of_chains, size, self._count, self._splats)

    def advance(self, walks: Walks, end: int) -> None:
        """Make the steps of a pass that ends after `end` per pixel."""
        if self._chains is not None:
            steps = max(1, self._total // self._count) * end // self._spp
            self._chains.advance(steps - self._steps, self._large, self._sigma)
            self._steps = steps

    def color(self) -> Color3f:
        """The image."""
        if self._chains is None or not self._steps:
            return dr.zeros(Color3f, self._pixels)
        self._chains.finish(self._large)
        factor = self._mean * self._pixels / (self._count * self._steps)
        return Color3f(*self._splats.sums()) * dr.opaque(Float, factor)


register_integrator("mmlt", MultiplexedMetropolis)
