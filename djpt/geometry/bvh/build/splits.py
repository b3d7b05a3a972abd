"""The choice of splits for the nodes of a BVH: one lane per node.

A split costs A(left) n(left) + A(right) n(right), with surfaces A and numbers of primitives n: the
surface area heuristic of MacDonald and Booth, "Heuristics for Ray Tracing Using Space Subdivision"
(1990). Large nodes are split between 16 bins per axis, as in Wald, "On fast Construction of SAH-based
Bounding Volume Hierarchies" (2007), small ones at the best of all their primitives.

Primitives are records of 8 words: low xyz, minus high xyz, number, unused. With the sign turned,
all six bounds are minima.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.jit.kernels import float_in, maximum, minimum, while_loop, wide
from djpt.jit.types import ArrayXu, Float, UInt32

__all__ = [
    "MIDDLE",
    "WORDS",
    "Nodes",
    "binned_split",
    "center",
    "exact_split",
    "load",
    "midpoint_split",
    "no_split",
]

WORDS = 8
BINS = 16
SAMPLES = 4096
"""A node of more primitives is split by a sample of about this size, beside all exceptionally large ones."""

MIDDLE = 3
"""Stands in place of an axis for the split by number: the first half of the primitives goes left."""

Bounds = list[Float]
"""The bounds of a box: low xyz, minus high xyz."""


@dataclass
class Nodes:
    """Ranges of primitives: `size` from `start` on, of which the first `large` are exceptionally large."""

    start: UInt32
    size: UInt32
    large: UInt32


@dataclass
class Split:
    """A split: primitives with (c - base) * scale < limit go left; c is twice the centroid along `axis`."""

    cost: Float
    axis: UInt32
    base: Float
    scale: Float
    limit: Float

    def words(self, nodes: Nodes) -> ArrayXu:
        """Pack the split into four words for the kernel that moves primitives; for MIDDLE, the limit is a position."""
        middle = nodes.start + nodes.size // 2
        limit = dr.select(self.axis == MIDDLE, middle, dr.reinterpret_array(UInt32, self.limit))
        base, scale = (dr.reinterpret_array(UInt32, x) for x in (self.base, self.scale))
        return ArrayXu(self.axis, base, scale, limit)


def no_split() -> Split:
    """The split by number at infinite cost, which any other split improves on."""
    return Split(Float(dr.inf), UInt32(MIDDLE), Float(0), Float(0), Float(0))


def better(a: Split, b: Split) -> Split:
    """The cheaper of two splits; `a` if they cost the same."""
    result: Split = dr.select(b.cost < a.cost, b, a)
    return result


def load(records: UInt32, index: UInt32) -> Bounds:
    """Read the bounds of a primitive."""
    words: Any = dr.gather(ArrayXu, records, index, shape=(WORDS, 1))
    return [float_in(words[k]) for k in range(6)]


def unite(a: Bounds, b: Bounds) -> Bounds:
    """The bounds of two boxes together."""
    return [minimum(x, y) for x, y in zip(a, b, strict=True)]


def nothing(lanes: int) -> Bounds:
    """The bounds of no primitives."""
    return [dr.full(Float, dr.inf, lanes) for _ in range(6)]


def half_area(bounds: Bounds) -> Float:
    """Half the surface area of a box: xy + yz + zx."""
    x, y, z = (-(bounds[a] + bounds[a + 3]) for a in range(3))
    return dr.fma(x, y, dr.fma(y, z, z * x))


def center(bounds: Bounds, axis: int) -> Float:
    """Twice the middle of a box along an axis."""
    return bounds[axis] - bounds[axis + 3]


@dataclass
class Sample:
    """The primitives of each node that its split is chosen by."""

    nodes: Nodes
    stride: UInt32
    count: UInt32

    def at(self, i: UInt32) -> tuple[UInt32, UInt32]:
        """The position of the i-th primitive of the sample, and how many primitives it stands for.

        One primitive of each run of `stride` is taken, at a hashed place: at regular places the sample could
        meet the same column of a regular mesh again and again.
        """
        nodes = self.nodes
        run = (i - nodes.large) * self.stride
        jitter: Any = dr.mul_hi(((i + 1) * 0x9E3779B9) ^ 0x85EBCA6B, self.stride)
        regular = nodes.large + dr.minimum(run + jitter, nodes.size - nodes.large - 1)
        is_large = i < nodes.large
        return nodes.start + dr.select(is_large, i, regular), dr.select(is_large, 1, self.stride)


def sample(nodes: Nodes) -> Sample:
    """Choose the sample of each node."""
    # At least 1: a division by zero ends the process, also in the unused lanes of the last packet.
    stride = dr.maximum((nodes.size + (SAMPLES - 1)) // SAMPLES, 1)
    count = nodes.large + (nodes.size - nodes.large + stride - 1) // stride
    return Sample(nodes, stride, count)


def center_bounds(records: UInt32, chosen: Sample) -> Bounds:
    """The bounds of the centroids, multiplied by 2."""
    lanes = dr.width(chosen.count)

    def turn(i: UInt32, bounds: Bounds) -> tuple[UInt32, Bounds]:
        box = load(records, chosen.at(i)[0])
        centers = [center(box, a) for a in range(3)]
        return i + 1, unite(bounds, [*centers, *(-c for c in centers)])

    _, bounds = while_loop(
        (dr.zeros(UInt32, lanes), nothing(lanes)), lambda i, _: i < chosen.count, turn, label="centroids"
    )
    return list(bounds)


def scales(bounds: Bounds) -> list[Float]:
    """Bins per unit of length along each axis; 0 for an axis along which all centroids agree."""
    result = []
    for a in range(3):
        scale = BINS * (1 - 1e-6) / -(bounds[a] + bounds[a + 3])
        result.append(dr.select(dr.isfinite(scale), scale, 0))
    return result


def binned_split(records: UInt32, nodes: Nodes) -> Split:
    """The cheapest split by one of 15 planes along each axis."""
    chosen = sample(nodes)
    lanes = dr.width(chosen.count)
    bounds = center_bounds(records, chosen)
    scale = scales(bounds)

    def throw(i: UInt32, bins: Any, counts: Any) -> tuple[UInt32, Any, Any]:
        position, weight = chosen.at(i)
        box = load(records, position)
        for a in range(3):
            # Clamped as a float: the integer part of a NaN could be any.
            place = minimum((center(box, a) - bounds[a]) * scale[a], Float(BINS - 1))
            bin = UInt32(maximum(place, Float(0))) + a * BINS
            for k in range(6):
                bins[bin * 6 + k] = minimum(bins[bin * 6 + k], box[k])
            counts[bin] = counts[bin] + weight
        return i + 1, bins, counts

    bins = dr.alloc_local(Float, 3 * BINS * 6, value=Float(dr.inf))
    counts = dr.alloc_local(UInt32, 3 * BINS, value=UInt32(0))
    _, bins, counts = while_loop(
        (dr.zeros(UInt32, lanes), bins, counts), lambda i, *_: i < chosen.count, throw, label="bins"
    )
    best = wide(no_split(), lanes)
    right_costs = dr.alloc_local(Float, BINS)
    _, best, *_ = while_loop(
        (dr.zeros(UInt32, lanes), best, bins, counts, right_costs),
        lambda axis, *_: axis < 3,
        lambda axis, best, bins, counts, right_costs: sweep(axis, best, bins, counts, right_costs, bounds, scale),
        label="axes",
    )
    return best


def sweep(
    axis: UInt32, best: Split, bins: Any, counts: Any, right_costs: Any, bounds: Bounds, scale: list[Float]
) -> tuple[UInt32, Split, Any, Any, Any]:
    """Compare the planes along an axis: sum up the right sides from the right, then the left sides from the left."""
    lanes = dr.width(best.cost)
    first = axis * BINS

    def grown(bin: UInt32, box: Bounds, count: UInt32, bins: Any, counts: Any) -> tuple[Bounds, UInt32, Float]:
        box = unite(box, [bins[(first + bin) * 6 + k] for k in range(6)])
        count = count + counts[first + bin]
        return box, count, dr.select(count > 0, half_area(box) * Float(count), 0)

    def from_right(bin: UInt32, box: Bounds, count: UInt32, bins: Any, counts: Any, right_costs: Any) -> Any:
        box, count, cost = grown(bin, box, count, bins, counts)
        right_costs[bin] = dr.select(count > 0, cost, dr.inf)
        return bin - 1, box, count, bins, counts, right_costs

    _, _, _, bins, counts, right_costs = while_loop(
        (dr.full(UInt32, BINS - 1, lanes), nothing(lanes), dr.zeros(UInt32, lanes), bins, counts, right_costs),
        lambda bin, *_: bin > 0,
        from_right,
        label="right sides",
    )
    base = dr.select(axis == 0, bounds[0], dr.select(axis == 1, bounds[1], bounds[2]))
    factor = dr.select(axis == 0, scale[0], dr.select(axis == 1, scale[1], scale[2]))

    def from_left(bin: UInt32, box: Bounds, count: UInt32, best: Split, bins: Any, counts: Any, costs: Any) -> Any:
        box, count, cost = grown(bin, box, count, bins, counts)
        total = dr.select((count > 0) & (factor > 0), cost + costs[bin + 1], dr.inf)
        split = Split(total, UInt32(axis), Float(base), Float(factor), Float(bin + 1))
        return bin + 1, box, count, better(best, split), bins, counts, costs

    _, _, _, best, bins, counts, right_costs = while_loop(
        (dr.zeros(UInt32, lanes), nothing(lanes), dr.zeros(UInt32, lanes), best, bins, counts, right_costs),
        lambda bin, *_: bin < BINS - 1,
        from_left,
        label="left sides",
    )
    return axis + 1, best, bins, counts, right_costs


def midpoint_split(records: UInt32, nodes: Nodes) -> Split:
    """The split in the middle of the longest axis of the centroids' bounds."""
    bounds = center_bounds(records, sample(nodes))
    scale = scales(bounds)
    best = no_split()
    for a in range(3):
        # The longest axis has the smallest positive scale.
        cost = dr.select(scale[a] > 0, scale[a], dr.inf)
        best = better(best, Split(cost, UInt32(a), bounds[a], scale[a], Float(BINS // 2)))
    return best


def exact_split(records: UInt32, nodes: Nodes) -> Split:
    """The cheapest of all splits by centroid along an axis, for nodes of a few primitives."""
    lanes = dr.width(nodes.start)
    end = nodes.start + nodes.size

    def try_candidate(i: UInt32, best: Split) -> tuple[UInt32, Split]:
        box = load(records, i)
        limits = [center(box, a) for a in range(3)]

        def assign(j: UInt32, left: list[Bounds], right: list[Bounds], counts: list[UInt32]) -> Any:
            other = load(records, j)
            for a in range(3):
                goes_left = center(other, a) < limits[a]
                left[a] = [dr.select(goes_left, x, y) for x, y in zip(unite(left[a], other), left[a], strict=True)]
                right[a] = [dr.select(goes_left, y, x) for x, y in zip(unite(right[a], other), right[a], strict=True)]
                counts[a] = counts[a] + dr.select(goes_left, UInt32(1), UInt32(0))
            return j + 1, left, right, counts

        empty = [nothing(lanes) for _ in range(3)]
        also = [nothing(lanes) for _ in range(3)]
        _, left, right, counts = while_loop(
            (UInt32(nodes.start), empty, also, [dr.zeros(UInt32, lanes) for _ in range(3)]),
            lambda j, *_: j < end,
            assign,
            label="sides",
        )
        for a in range(3):
            cost = dr.fma(half_area(left[a]), Float(counts[a]), half_area(right[a]) * Float(nodes.size - counts[a]))
            split = Split(dr.select(counts[a] > 0, cost, dr.inf), UInt32(a), Float(0), Float(1), limits[a])
            best = better(best, split)
        return i + 1, best

    best = wide(no_split(), lanes)
    _, best = while_loop((UInt32(nodes.start), best), lambda i, _: i < end, try_candidate, label="candidates")
    return best
