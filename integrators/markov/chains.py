"""Markov chains of paths: the bootstrap that finds their first samples, and their steps.

N. Metropolis et al., "Equation of State Calculations by Fast Computing Machines", 1953; the bootstrap is that of
E. Veach and L. Guibas, "Metropolis Light Transport", 1997, the weights are those of C. Kelemen et al., 2002.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.films.footprint import Splats
from djpt.integrators.bidirectional.single_strategy import LastVertex, SingleStrategy
from djpt.jit.kernels import loop_traced_once, maximum, minimum, own_copy, own_floats, while_loop
from djpt.jit.llvm.lanes import small_blocks
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.samplers.independent import IndependentStream
from djpt.samplers.seeds import sample_tea_32

__all__ = ["Bootstrap", "MarkovChains", "Mutated", "brightness", "step"]

FINEST = 1 / 64
"""The smallest step, as a fraction of the largest."""

BELOW_ONE = 1 - 2.0**-24
"""The largest float below 1."""


def step(u: Float, a: Float, largest: Float) -> Float:
    """Move the number `u` in [0, 1) a little, as a uniform number `a` says: the interval is a circle.

    The distance lies between `largest` / 64 and `largest`, with a density that is proportional to its inverse. Steps to
    and fro are equally likely.
    """
    up = a < 0.5
    b = 2 * dr.select(up, a, a - 0.5)
    distance = largest * dr.exp2(b * math.log2(FINEST))
    moved = u + dr.select(up, distance, -distance)
    return minimum(moved - dr.floor(moved), BELOW_ONE)


@dataclass
class Mutated:
    """A `SampleStream` of a proposal: it mutates the numbers of a chain while they are drawn.

    C. Kelemen, L. Szirmay-Kalos, G. Antal and F. Csonka, "A Simple and Robust Mutation Strategy for the Metropolis
    Light Transport Algorithm", 2002.

    Local memory has room for both. The proposal's numbers are written to the place that isn't the chain's, so that to
    accept them is to exchange the roles of the two.
    """

    generator: IndependentStream
    memory: Any
    own: UInt32
    """Index of the next number of the chain."""
    other: UInt32
    """Index at which the proposal's number is stored."""
    is_large: Bool
    """True where all numbers are drawn afresh."""
    largest: Float
    """The largest step of the others."""

    @staticmethod
    def of(
        generator: IndependentStream, memory: Any, second: Bool, size: int, is_large: Bool, largest: Float
    ) -> Mutated:
        """The numbers of a proposal; `second`: the chain's stand in the second half of the memory, after `size`."""
        first, middle = UInt32(0), UInt32(size)
        own, other = dr.select(second, middle, first), dr.select(second, first, middle)
        return Mutated(generator, memory, own, other, is_large, largest)

    def clone(self) -> Mutated:
        """Two of them would write to the same memory."""
        raise NotImplementedError("the numbers of a proposal are drawn once")

    def next_1d(self, active: Bool | bool = True) -> Float:
        a, u = self.generator.next_1d(), self.memory.read(self.own)
        number = dr.select(self.is_large, a, step(u, a, self.largest))
        self.memory.write(number, self.other)
        self.own, self.other = self.own + 1, self.other + 1
        return number

    def next_2d(self, active: Bool | bool = True) -> Point2f:
        x = self.next_1d()
        return Point2f(x, self.next_1d())


TINY = 1e-300
"""In place of 0, to divide by."""

BATCH = 2**18
"""Samples of the bootstrap that are computed at once."""

SHORTEST = 2
"""The edges of the shortest paths: those of one have a single strategy, and are left to the camera's side."""


EVEN = 0.2
"""The share of the chains that is spread evenly over all lengths of paths, so that those that bring little are seen."""


def brightness(light: Color3f) -> Float:
    """The density of chains: the largest component, so that no colour counts for little."""
    return maximum(maximum(light.x, light.y), light.z)


@dataclass
class Start:
    """Independent samples, from which chains can begin."""

    generator: IndependentStream
    """The state before the numbers of the path."""
    s: UInt32
    place: Point2f
    light: Color3f


@dataclass
class Family:
    """Values that all chains of one length share, per chain."""

    edges: UInt32
    mean: Float
    """The mean brightness of samples of this length."""
    worth: Float
    """The fraction of the light that paths of this length bring, over the fraction of chains that follow them."""


class Bootstrap:
    """Independent samples of all lengths of paths, equally many of each: how bright they are.

    Their mean brightness normalises the image; and chains begin at some of them, chosen by brightness, so that they
    needn't run for a while before they count: the expectation is right from the first step (Veach and Guibas, 1997).
    """

    def __init__(self, strategy: SingleStrategy, seed: UInt32, max_depth: int, samples: int) -> None:
        """`samples`: their number, about."""
        self._strategy, self._seed = strategy, seed
        lengths = max_depth - SHORTEST + 1
        self._each = max(1, samples // lengths)
        count = self._each * lengths
        found = [self._brightness(begin, min(begin + BATCH, count)) for begin in range(0, count, BATCH)]
        bright = np.concatenate(found).astype(np.float64).reshape(lengths, self._each)
        self._means = bright.mean(axis=1)
        lit = self._means > 0
        shares = self._means / max(self.mean, TINY)
        chosen = np.where(lit, (1 - EVEN) * shares + EVEN / max(1, lit.sum()), 0)
        self._excess = chosen / np.where(lit, shares, 1)
        self._sums = np.cumsum(bright * self._excess[:, None])

    @property
    def mean(self) -> float:
        """The mean brightness, summed over lengths."""
        return float(self._means.sum())

    def _brightness(self, begin: int, end: int) -> NDArray[np.float32]:
        start = self._samples(dr.arange(UInt32, end - begin) + dr.opaque(UInt32, begin))
        bright = brightness(start.light)
        bright = dr.select(bright < dr.inf, bright, 0)
        with small_blocks():
            dr.eval(bright, start)
        return np.array(bright)

    def _samples(self, number: UInt32) -> Start:
        generator = IndependentStream.seeded(*sample_tea_32(self._seed, number))
        edges = number // dr.opaque(UInt32, self._each) + SHORTEST
        s = self._strategy.chosen(edges, generator.next_1d())
        before = generator.clone()
        place, light, _, _ = self._strategy.sample(edges, s, generator, dr.alloc_local(LastVertex, 2))
        return Start(before, s, place, light)

    def starts(self, count: int) -> tuple[Start, Family]:
        """The first samples of `count` chains, chosen by brightness, shortest paths first."""
        # Systematic resampling: each sample is taken as often as its fraction asks for, or once more.
        offset = np.array(IndependentStream.seeded(*sample_tea_32(self._seed, 0xFFFFFFFF)).next_1d())[0]
        wanted = (np.arange(count) + float(offset)) * (self._sums[-1] / count)
        chosen = np.minimum(np.searchsorted(self._sums, wanted, side="right"), len(self._sums) - 1)
        start, length = self._samples(own_copy(chosen.astype(np.uint32))), chosen // self._each
        with small_blocks():
            dr.eval(brightness(start.light), start)
        family = Family(
            edges=own_copy((length + SHORTEST).astype(np.uint32)),
            mean=own_floats(self._means[length].astype(np.float32)),
            worth=own_floats((1 / self._excess[length]).astype(np.float32)),
        )
        return start, family


@dataclass
class Chains:
    """Loop state: a chain per lane."""

    step: UInt32
    generator: IndependentStream
    memory: Any
    """The numbers of the chain and of its proposal: see `Mutated`."""
    second: Bool
    """True where the second of the two is the chain's."""
    last: Any
    """Local memory of `SingleStrategy.sample`."""
    s: UInt32
    place: Point2f
    light: Color3f
    weight: Float
    """The sum of the weights with which the chain's sample has counted since it was accepted."""


class MarkovChains:
    """Chains of paths of fixed lengths: of each about as many as its fraction of the light, and some that are dark.

    A step proposes a path: in a *large* one all its numbers are drawn afresh, in others all are moved a little, and
    the strategy is kept. With y = `brightness` of the chain's sample and y' that of the proposal the chain goes there
    with the probability a = min(1, y' / y). Both are added to the image whatever happens, with their expected weights

        proposal:  (a + [large step]) f' b / (y' + p b_k),      chain:  (1 - a) f b / (y + p b_k),

    b and b_k: the mean brightness of all samples, and of those of this length; p: the probability of large steps, which
    are independent samples besides being proposals. Lengths that have more chains than their share of the light count
    less by that factor.
    """

    def __init__(
        self, strategy: SingleStrategy, bootstrap: Bootstrap, seed: UInt32, size: int, chains: int, splats: Splats
    ) -> None:
        """`size`: the numbers of a path; `splats`: takes the light, divided by b."""
        self._strategy, self._splats, self._size, self._chains = strategy, splats, size, chains
        start, self._family = bootstrap.starts(chains)
        lane = dr.arange(UInt32, chains)
        self._generator = IndependentStream.seeded(*sample_tea_32(seed, lane))
        self._s, self._place, self._light = start.s, start.place, start.light
        self._weight = dr.zeros(Float, chains)
        self._numbers = dr.empty(Float, chains * size)
        end, stride = dr.opaque(UInt32, size), dr.opaque(UInt32, chains)

        def draw(i: UInt32, generator: IndependentStream) -> tuple[UInt32, IndependentStream]:
            dr.scatter(self._numbers, generator.next_1d(), dr.fma(i, stride, lane))
            return i + 1, generator

        first = dr.zeros(UInt32, chains)
        i, _ = while_loop((first, start.generator), lambda i, _: i < end, draw, label="first numbers")
        dr.eval(i, self._numbers, self._generator)

    def advance(self, steps: int, large: Float, largest: Float) -> None:
        """Make some steps; `large` is the probability of large ones, and `largest` how far others move a number."""
        end, size = dr.opaque(UInt32, steps), self._size
        floor = self._family.mean * large

        def next_step(c: Chains) -> tuple[Chains]:
            is_large = c.generator.next_1d() < large
            s = dr.select(is_large, self._strategy.chosen(self._family.edges, c.generator.next_1d()), c.s)
            numbers = Mutated.of(c.generator, c.memory, c.second, size, is_large, largest)
            place, light, numbers, last = self._strategy.sample(self._family.edges, s, numbers, c.last)  # type: ignore[assignment]
            y, proposed = brightness(c.light), brightness(light)
            a = dr.select(proposed < y, proposed * dr.rcp(y), 1)
            accepted = numbers.generator.next_1d() < a
            stays, goes = c.weight + 1 - a, a + dr.select(is_large, Float(1), 0)
            # Of the two, the one that is left behind.
            self._add(
                dr.select(accepted, c.place, place),
                dr.select(accepted, c.light, light),
                dr.select(accepted, stays, goes),
                floor,
            )
            return (
                Chains(
                    step=c.step + 1,
                    generator=numbers.generator,
                    memory=numbers.memory,
                    second=c.second ^ accepted,
                    last=last,
                    s=dr.select(accepted, s, c.s),
                    place=dr.select(accepted, place, c.place),
                    light=dr.select(accepted, light, c.light),
                    weight=dr.select(accepted, goes, stays),
                ),
            )

        start = Chains(
            step=dr.zeros(UInt32, self._chains),
            generator=self._generator,
            memory=self._read(),
            second=dr.full(Bool, False, self._chains),
            last=dr.alloc_local(LastVertex, 2),
            s=self._s,
            place=self._place,
            light=self._light,
            weight=self._weight,
        )
        (c,) = loop_traced_once(start, lambda c: c.step < end, next_step, "chains")
        done = self._write(c)
        self._generator, self._s, self._place = c.generator, c.s, c.place
        self._light, self._weight = c.light, c.weight
        with small_blocks():
            dr.eval(done, self._numbers, self._generator, self._s, self._place, self._light, self._weight)
            dr.eval(self._splats.memory)

    def finish(self, large: Float) -> None:
        """Add the samples at which the chains stand."""
        self._add(self._place, self._light, self._weight, self._family.mean * large)
        dr.eval(self._splats.memory)

    def _add(self, place: Point2f, light: Color3f, weight: Float, floor: Float) -> None:
        bright = brightness(light)
        weight = weight * self._family.worth
        self._splats.add(place, light * (weight * dr.rcp(bright + floor)), (weight > 0) & (bright > 0))

    # ---- numbers between passes ---------------------------------------------------------

    def _read(self) -> Any:
        """The numbers of all chains, in local memory."""
        lane, end, stride = (
            dr.arange(UInt32, self._chains),
            dr.opaque(UInt32, self._size),
            dr.opaque(UInt32, self._chains),
        )

        def read(i: UInt32, memory: Any) -> tuple[UInt32, Any]:
            memory.write(dr.gather(Float, self._numbers, dr.fma(i, stride, lane)), i)
            return i + 1, memory

        start = dr.zeros(UInt32, self._chains), dr.alloc_local(Float, 2 * self._size)
        return while_loop(start, lambda i, _: i < end, read, label="read numbers")[1]

    def _write(self, c: Chains) -> UInt32:
        """Take over the numbers of all chains; returns what must be evaluated for it."""
        lane, end, stride = (
            dr.arange(UInt32, self._chains),
            dr.opaque(UInt32, self._size),
            dr.opaque(UInt32, self._chains),
        )
        numbers, begin = dr.empty(Float, self._chains * self._size), dr.select(c.second, UInt32(self._size), 0)

        def write(i: UInt32, memory: Any) -> tuple[UInt32, Any]:
            dr.scatter(numbers, memory.read(begin + i), dr.fma(i, stride, lane))
            return i + 1, memory

        start = dr.zeros(UInt32, self._chains), c.memory
        done: UInt32 = while_loop(start, lambda i, _: i < end, write, label="write numbers")[0]
        self._numbers = numbers
        return done
