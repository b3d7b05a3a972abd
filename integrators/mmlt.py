"""Metropolis light transport with the strategies of bidirectional path tracing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import drjit as dr
import numpy as np

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.films.splats import Splats
from djpt.integrators.bdpt import BidirectionalPath
from djpt.integrators.mutations import Fresh, Mutated, Mutation
from djpt.integrators.one_strategy import LastVertex, OneStrategy, numbers_drawn
from djpt.integrators.passes import PassIntegrator, Walks
from djpt.integrators.path import Path
from djpt.kernels import loop_traced_once, own_copy, own_floats, while_loop, wide
from djpt.llvm.lanes import small_blocks
from djpt.samplers.hashing import sample_tea_32
from djpt.samplers.independent import IndependentStream
from djpt.scene import Scene
from djpt.sensors.base import Sensor
from djpt.types import Bool, Color3f, Float, Point2f, UInt32

__all__ = ["MultiplexedMetropolis"]

MAX_EDGES = 32
"""The most edges of a path."""

BATCH = 2**18
"""Samples of the bootstrap that are computed at once."""

ROUNDS = 8
"""Rounds of the hash that seeds generators."""


@dataclass
class Chains:
    """Loop state: a Markov chain per lane."""

    step: UInt32
    generator: IndependentStream
    memory: Any
    """The numbers of the chain and of its proposal: see `Mutated`."""
    second: Bool
    """Which of the two the chain's are."""
    last: Any
    """Local memory of `OneStrategy.sample`."""
    place: Point2f
    light: Color3f
    weight: Float
    """The sum of the weights with which the chain's sample counts, since it was accepted."""


class MultiplexedMetropolis(PassIntegrator):
    """Follows Markov chains of paths: where much light is found, more paths are tried nearby.

    """

    starts_at_lights = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.max_depth = props.integer("max_depth", 8, low=1, high=MAX_EDGES)
        self.bootstrap_samples = props.integer("bootstrap_samples", 0, low=0)
        self.chains = props.integer("chains", 2**14, low=1)
        self.large_steps = props.float("large_step_probability", 0.3, low=0.0, high=1.0)
        self.sigma = props.float("sigma", 1 / 16, low=0.0, high=0.5)
        shared = {"hide_emitters": self.hide_emitters}
        ends = {"max_depth": self.max_depth, "rr_depth": self.max_depth + 1, "emitter_choice": "uniform", **shared}
        self.ends = BidirectionalPath(Properties("bdpt", f"{props.node}.ends", ends))
        # For light that comes straight from an emitter.
        self.from_camera = Path(Properties("path", f"{props.node}.straight", {"max_depth": 1, **shared}))

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        self.ends.check_scene(scene, sensor)
        super().check_scene(scene, sensor)

    def begin(self, walks: Walks) -> Any:
        return Metropolis(self, walks)

    def add_pass(self, walks: Walks, state: Any, begin: int, end: int) -> Any:
        state.advance(begin, end)
        return state

    def color(self, walks: Walks, state: Any) -> Color3f:
        return state.color()


class Metropolis:
    def __init__(self, it: MultiplexedMetropolis, walks: Walks) -> None:
        self.it, self.walks = it, walks
        self.strategy = OneStrategy(it.ends, walks.scene, walks.camera, walks.ray_at)
        self.splats = Splats(walks.film, 1.0)
        self.size = numbers_drawn(it.max_depth)
        self.lengths = it.max_depth - 1
        width, height = walks.film.crop_size()
        self.pixels = width * height
        total = walks.spp * self.pixels
        self.chains = min(it.chains, max(1, total // 16))
        self.steps_all = max(1, total // self.chains)
        self.done = 0
        per_length = (it.bootstrap_samples or max(2**17, total // 4)) // self.lengths
        n = per_length * self.lengths
        y = np.concatenate([self.fresh(np.arange(b, min(b + BATCH, n)), per_length)[1] for b in range(0, n, BATCH)])
        y = y.astype(np.float64)
        self.mean = y.sum() / per_length
        means = y.reshape(self.lengths, per_length).mean(axis=1)
        self.means = means
        cdf = np.cumsum(y)
        u = IndependentStream.seeded(*sample_tea_32(self.walks.seed, UInt32(0xFFFFFFFF), ROUNDS)).next_1d().numpy()[0]
        picks = np.searchsorted(cdf, (np.arange(self.chains) + u) / self.chains * cdf[-1])
        picks = np.minimum(picks, n - 1)
        (place, light), _ = self.fresh(picks, per_length)
        lengths = picks // per_length
        self.edges = own_copy((lengths + 2).astype(np.uint32))
        self.own_mean = own_floats(means[lengths].astype(np.float32))
        self.place, self.light = place, light
        self.weight = dr.zeros(Float, self.chains)
        key = own_copy(picks.astype(np.uint32))
        gen = IndependentStream.seeded(*sample_tea_32(self.walks.seed, key, ROUNDS))
        lane = dr.arange(UInt32, self.chains)
        self.numbers = dr.empty(Float, self.chains * self.size)
        size, chains = dr.opaque(UInt32, self.size), dr.opaque(UInt32, self.chains)
        numbers = self.numbers

        def write(d, gen):
            dr.scatter(numbers, gen.next_1d(), d * chains + lane)
            return d + 1, gen

        d, _ = while_loop((dr.zeros(UInt32, self.chains), gen), lambda d, gen: d < size, write, label="first points")
        dr.eval(d, self.numbers)
        self.generator = IndependentStream.seeded(*sample_tea_32(self.walks.seed + 0x632BE5AB, lane, ROUNDS))
        dr.eval(self.generator, self.weight)

    def fresh(self, numbers, per_length):
        number = own_copy(numbers.astype(np.uint32))
        edges = number // dr.opaque(UInt32, per_length) + 2
        gen = IndependentStream.seeded(*sample_tea_32(self.walks.seed, number, ROUNDS))
        place, light, _, _ = self.strategy.sample(edges, Fresh(gen), dr.alloc_local(LastVertex, 2))
        y = dr.max(light)
        with small_blocks():
            dr.eval(place, light, y)
        return (place, light), y.numpy()

    def advance(self, begin, end):
        begin = self.steps_all * begin // self.walks.spp
        end = self.steps_all * end // self.walks.spp
        self.done = end
        it, size = self.it, self.size
        lane = dr.arange(UInt32, self.chains)
        chains = dr.opaque(UInt32, self.chains)
        large, sigma = dr.opaque(Float, it.large_steps), dr.opaque(Float, it.sigma)
        stop = dr.opaque(UInt32, end - begin)
        floor = self.own_mean * large
        memory = dr.alloc_local(Float, 2 * size)
        numbers, size_value = self.numbers, dr.opaque(UInt32, size)

        def read(d, memory):
            memory.write(dr.gather(Float, numbers, d * chains + lane), d)
            return d + 1, memory

        _, memory = while_loop((dr.zeros(UInt32, self.chains), memory), lambda d, m: d < size_value, read, label="read")
        edges = self.edges

        def body(c: Chains):
            mutation = Mutation.chosen(c.generator.next_1d(), large)
            proposal = Mutated.of(c.generator, c.memory, c.second, size, mutation, sigma)
            place, light, proposal, last = self.strategy.sample(edges, proposal, c.last)
            y, new = dr.max(c.light), dr.max(light)
            a = dr.select(new < y, new * dr.rcp(y), 1)
            generator = proposal.generator
            accepted = generator.next_1d() < a
            w_new = a + dr.select(mutation.is_large, Float(1), 0)
            w_old = c.weight + 1 - a
            # What the chain leaves, or what it doesn't go to.
            weight = dr.select(accepted, w_old, w_new)
            color = dr.select(accepted, c.light, light)
            self.splats.add(
                dr.select(accepted, c.place, place), color * (weight * dr.rcp(dr.max(color) + floor)),
                (weight > 0) & (dr.max(color) > 0),
            )
            return (Chains(
                c.step + 1, generator, proposal.memory, c.second ^ accepted, last,
                dr.select(accepted, place, c.place), dr.select(accepted, light, c.light),
                dr.select(accepted, w_new, w_old)),)

        start = Chains(dr.zeros(UInt32, self.chains), self.generator, memory, dr.full(Bool, False, self.chains),
                       dr.alloc_local(LastVertex, 2), self.place, self.light, self.weight)
        (c,) = loop_traced_once(start, lambda c: c.step < stop, body, "chains")
        if end == self.steps_all:
            self.splats.add(c.place, c.light * (c.weight * dr.rcp(dr.max(c.light) + floor)), Bool(True))
        out = dr.empty(Float, self.chains * size)
        offset = dr.select(c.second, UInt32(size), 0)

        def write(d, memory):
            dr.scatter(out, memory.read(offset + d), d * chains + lane)
            return d + 1, memory

        d, _ = while_loop((dr.zeros(UInt32, self.chains), c.memory), lambda d, m: d < size_value, write, label="write")
        with small_blocks():
            dr.eval(d, out, self.splats.memory, c.generator, c.place, c.light, c.weight)
        self.numbers, self.generator, self.place, self.light, self.weight = out, c.generator, c.place, c.light, c.weight

    def color(self):
        return Color3f(*self.splats.sums()) * dr.opaque(Float, self.mean * self.pixels / (self.chains * self.done))


register_integrator("mmlt", MultiplexedMetropolis)
