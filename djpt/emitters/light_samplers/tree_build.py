"""Building the tree of lights: on the host, level by level, all nodes of a level at once.

In memory an inner node is a record of 16 words, 64 bytes, with both of its children, 8 words each:

======  ========================================================================
word    child
======  ========================================================================
0 .. 2  centre of its bounding sphere
3       radius
4       intensity: power over solid angle
5       axis, 3 x 10 bits, not normalised
6       cos theta_o in the lower, cos theta_e in the upper half, as shares of 65535
7       link: the number of an inner node, or LEAF and an emitter
======  ========================================================================

Cones are rounded outwards.

A node is split where the surface area orientation heuristic is least: the sum over both sides of
intensity times solid angle times extent (A. Conty Estevez and C. Kulla, "Importance Sampling of Many
Lights with Adaptive Tree Splitting", 2018, section 4.4), over `BINS` bins per axis. The extent is the
squared diagonal, that of the bounding spheres by which nodes are judged: unlike the surface it
doesn't vanish for lights in a line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.emitters.base import LightBounds
from djpt.jit.kernels import float_in, maximum, own_copy
from djpt.jit.types import ArrayXu, Float, Int32, Point3f, UInt32, Vector3f

__all__ = ["LEAF", "Child", "Lights", "Tree", "angle_between", "build", "children", "pack", "solid_angle", "unit"]

LEAF = 0x80000000
"""In a link: it leads to a light, whose number is in the other bits."""

BINS = 12
CHUNK = 4096
"""Nodes that are split at a time: bounds temporary memory."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass
class Lights:
    """Boxes, cones and intensities of lights or of nodes: arrays whose first axis counts them."""

    low: Floats
    high: Floats
    axis: Floats
    theta_o: Floats
    theta_e: Floats
    intensity: Floats
    """Power over the solid angle of emission: at the same distance, equal intensities give equal irradiance."""

    @staticmethod
    def of(bounds: Sequence[LightBounds], weights: Floats) -> Lights:
        """The bounds of some emitters, the power of each one multiplied by its weight."""
        theta_o, theta_e = np.array([b.theta_o for b in bounds]), np.array([b.theta_e for b in bounds])
        power = np.array([b.power for b in bounds]) * weights
        return Lights(
            np.array([b.low for b in bounds], np.float64),
            np.array([b.high for b in bounds], np.float64),
            np.array([b.axis for b in bounds], np.float64),
            theta_o,
            theta_e,
            power / solid_angle(theta_o, theta_e),
        )

    @staticmethod
    def empty(*shape: int) -> Lights:
        """Arrays of zeros."""
        vectors, numbers = [np.zeros((*shape, 3)) for _ in range(3)], [np.zeros(shape) for _ in range(3)]
        return Lights(vectors[0], vectors[1], vectors[2], numbers[0], numbers[1], numbers[2])

    def united(self, members: Ints, begins: Ints) -> Lights:
        """The nodes that hold runs of `members`, which begin at `begins`."""
        count = np.diff(np.append(begins, len(members)))
        own = self.axis[members]
        axis, first = np.add.reduceat(own, begins), own[begins]
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        # Opposite axes cancel: then any axis will do.
        axis = np.where(length > 1e-6, axis / np.maximum(length, 1e-6), first)
        angle = np.where(count.repeat(count) > 1, angle_between(axis.repeat(count, axis=0), own), 0)
        return Lights(
            np.minimum.reduceat(self.low[members], begins),
            np.maximum.reduceat(self.high[members], begins),
            axis,
            np.minimum(np.maximum.reduceat(angle + self.theta_o[members], begins), np.pi),
            np.maximum.reduceat(self.theta_e[members], begins),
            np.add.reduceat(self.intensity[members], begins),
        )


@dataclass
class Tree:
    """A binary tree over n lights.

    Its leaves have ranks from left to right. The inner node that parts the leaves of rank < m from those
    of rank >= m has the number m, which no other has; so the way to a leaf is told by its rank.
    """

    rank: Ints
    """The rank of each light's leaf."""
    children: Lights
    """The left and the right child of each inner node, (n, 2); row 0 is unused."""
    links: NDArray[np.uint32]
    """The children, (n, 2): the number of an inner node, or LEAF and a light."""
    root: int
    """A link."""


def build(lights: Lights) -> Tree:
    """Build the tree over some lights, at least one."""
    n = len(lights.intensity)
    order = np.arange(n)
    tree = Tree(np.zeros(n, np.int64), Lights.empty(2 * n), np.zeros(2 * n, np.uint32), LEAF)
    begin, end, parent = np.zeros(1, np.int64), np.full(1, n), np.full(1, -1)
    while True:
        inner = end - begin >= 2
        begin, end, parent = begin[inner], end[inner], parent[inner]
        if not len(begin):
            break
        size = end - begin
        first = np.cumsum(size) - size
        node = np.arange(len(begin)).repeat(size)
        at = np.arange(len(node)) - first[node] + begin[node]
        right = goes_right(lights, order[at], node, first, size)
        members = order[at][np.argsort(2 * node + right, kind="stable")]
        order[at] = members
        number = end - np.add.reduceat(right.astype(np.int64), first)
        if parent[0] < 0:
            tree.root = int(number[0])
        else:
            tree.links[parent] = number
        slots = (2 * number[:, None] + [0, 1]).ravel()
        child_begin, child_end = np.stack([begin, number], 1).ravel(), np.stack([number, end], 1).ravel()
        child_first = np.stack([first, first + number - begin], 1).ravel()
        united = lights.united(members, child_first)
        for name, values in vars(united).items():
            getattr(tree.children, name)[slots] = values
        single = child_end - child_begin == 1
        tree.links[slots[single]] = members[child_first[single]].astype(np.uint32) | np.uint32(LEAF)
        begin, end, parent = child_begin, child_end, slots
    tree.rank[order] = np.arange(n)
    for name, values in vars(tree.children).items():
        setattr(tree.children, name, values.reshape(n, 2, *values.shape[1:]))
    tree.links = tree.links.reshape(n, 2)
    return tree


def goes_right(lights: Lights, members: Ints, node: Ints, first: Ints, size: Ints) -> NDArray[np.bool_]:
    """Mark the members of some nodes that go to the right child. A node's `size` members begin at `first`."""
    center = (lights.low[members] + lights.high[members]) / 2
    low, high = np.minimum.reduceat(center, first), np.maximum.reduceat(center, first)
    extent = high - low
    scale = np.divide(BINS, extent, out=np.zeros_like(extent), where=extent > 0)
    bins = np.minimum((center - low[node]) * scale[node], BINS - 1).astype(np.int64)
    # Where all centres are one, and for pairs, there is nothing to weigh.
    axis, limit = np.full(len(first), -1), size // 2
    weighed = np.nonzero((size > 2) & (extent.max(axis=1) > 0))[0]
    for begin in range(0, len(weighed), CHUNK):
        part = weighed[begin : begin + CHUNK]
        chosen = np.full(len(first), -1)
        chosen[part] = np.arange(len(part))
        mine = chosen[node] >= 0
        axis[part], limit[part] = best_split(lights, members[mine], chosen[node[mine]], bins[mine], len(part))
    position = np.arange(len(members)) - first[node]
    along = np.take_along_axis(bins, np.maximum(axis, 0)[node][:, None], axis=1)[:, 0]
    right: NDArray[np.bool_] = np.where(axis[node] < 0, position, along) >= limit[node]
    return right


def best_split(lights: Lights, members: Ints, node: Ints, bins: Ints, nodes: int) -> tuple[Ints, Ints]:
    """Per node the axis and the first bin of the right side; `bins` of the members, (members, 3)."""
    key = ((node[:, None] * 3 + np.arange(3)) * BINS + bins).ravel()
    of = members.repeat(3)
    shape = (nodes, 3, BINS)

    def added(values: Floats) -> Floats:
        return np.asarray(np.bincount(key, values[of], nodes * 3 * BINS), np.float64).reshape(shape)

    def largest(values: Floats) -> Floats:
        result = np.full((nodes * 3 * BINS, *values.shape[1:]), -np.inf)
        np.maximum.at(result, key, values)
        return result.reshape(*shape, *values.shape[1:])

    axis = np.stack([added(lights.axis[:, k]) for k in range(3)], axis=-1)
    own = unit(axis).reshape(-1, 3)[key]
    content = Bins(
        np.bincount(key, minlength=nodes * 3 * BINS).reshape(shape),
        added(lights.intensity),
        np.stack([largest(-lights.low[of, k]) for k in range(3)], axis=-1),
        np.stack([largest(lights.high[of, k]) for k in range(3)], axis=-1),
        axis,
        largest(arc_cosine((own * lights.axis[of]).sum(axis=1)) + lights.theta_o[of]),
        largest(lights.theta_e[of]),
    )
    cost = (content.costs()[..., :-1] + content.reversed().costs()[..., ::-1][..., 1:]).reshape(nodes, -1)
    best = np.argmin(cost, axis=1)
    return best // (BINS - 1), best % (BINS - 1) + 1


@dataclass
class Bins:
    """The contents of bins along axes, (nodes, 3, BINS)."""

    count: Ints
    intensity: Floats
    minus_low: Floats
    high: Floats
    axis: Floats
    """Sums of axes, not normalised."""
    theta_o: Floats
    """Angle of the cone of normals about the direction of `axis`."""
    theta_e: Floats

    def reversed(self) -> Bins:
        """The bins from last to first."""
        return Bins(*(values[:, :, ::-1] for values in vars(self).values()))

    def costs(self) -> Floats:
        """The costs of the first bin, of the first two, and so on; infinite while there is nothing."""
        size = np.maximum.accumulate(self.minus_low, axis=2) + np.maximum.accumulate(self.high, axis=2)
        total = unit(np.cumsum(self.axis, axis=2))
        # Angles from the axis of the first k bins to that of each bin among them.
        cos = np.einsum("nakx,najx->nakj", total.astype(np.float32), unit(self.axis).astype(np.float32))
        theta_o = np.where(np.tri(BINS, dtype=bool), arc_cosine(cos) + self.theta_o[:, :, None], -np.inf).max(axis=3)
        theta_e = np.maximum.accumulate(self.theta_e, axis=2)
        filled = np.cumsum(self.count, axis=2) > 0
        theta_o, theta_e = np.where(filled, theta_o, 0), np.where(filled, theta_e, 0)
        squared = np.where(filled, (np.where(filled[..., None], size, 0) ** 2).sum(axis=-1), np.inf)
        weight = np.cumsum(self.intensity, axis=2) * solid_angle(theta_o, theta_e)
        # A side of no extent is free, but not one of no lights.
        return np.where(filled, weight * np.where(filled, squared, 0), np.inf)


def solid_angle(theta_o: Floats, theta_e: Floats) -> Floats:
    """The solid angle that light goes to, weighted by the cosine to the nearest normal.

    2 pi (1 - cos theta_o) + integral from theta_o to theta_w of cos(t - theta_o) sin t dt 2 pi, with
    theta_w = min(theta_o + theta_e, pi): 4 pi for a point light or a sphere, pi for a flat lamp.
    """
    theta_o = np.minimum(theta_o, np.pi)
    theta_w = np.minimum(theta_o + theta_e, np.pi)
    cone = 2 * np.pi * (1 - np.cos(theta_o))
    rest = 2 * theta_w * np.sin(theta_o) - np.cos(theta_o - 2 * theta_w)
    rest += np.cos(theta_o) - 2 * theta_o * np.sin(theta_o)
    # A beam without width has no solid angle.
    result: Floats = np.maximum(cone + np.pi / 2 * rest, 1e-3)
    return result


def angle_between(a: Floats, b: Floats) -> Floats:
    """Angles between unit vectors, exact for small ones as well."""
    return np.asarray(2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=-1) / 2, 1)))


def arc_cosine(x: Floats) -> Floats:
    """`arccos`, also of what rounding made larger than 1."""
    return np.asarray(np.arccos(np.clip(x, -1, 1)))


def unit(v: Floats) -> Floats:
    """Vectors scaled to unit length; zeros stay."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30))


WORDS = 8

AXIS_BITS, CONE_STEPS = 10, 65535
MASK, HALF = 2**AXIS_BITS - 1, 2 ** (AXIS_BITS - 1) - 1

SLACK = 2e-3
"""Directions count as lit that lie outside of a cone by less than this, in cosines: the rounding of `importance`."""

NEAR = 0.25
"""The squared distance counts at least this fraction of the squared radius.

Within a ball the mean of 1 / dist^2 is 3 / radius^2 at the centre. Bounds (1 / radius^2 and less) would guide worse:
among 1000 lights over a floor the variance is then four times larger.
"""

BOUND_WEIGHT = 0.3
"""The fraction of a cosine's largest value in the sphere; the rest is its value at the centre.

Bounds alone have 1.6 times the variance.
"""

LEAST_EMISSION, LEAST_RECEPTION = 0.01, 0.03
"""Cosines count at least this much.

At grazing angles estimates err most, and shading normals see light that the geometric normal doesn't: what could
contribute must not be chosen too rarely.
"""


def pack(tree: Tree, scale: float) -> UInt32:
    """The records of all inner nodes, in memory of their own; intensities are multiplied by `scale`."""
    words = np.zeros((*tree.links.shape, WORDS), np.uint32)
    if len(words) > 1:
        words[1:] = encode(tree.children, tree.links, scale)[1:]
    return own_copy(words)


def encode(nodes: Lights, links: NDArray[np.uint32], scale: float) -> NDArray[np.uint32]:
    """The words of some children, (..., WORDS)."""
    center = ((nodes.low + nodes.high) / 2).astype(np.float32)
    reach = np.maximum(nodes.high - center, center - nodes.low)
    radius = np.linalg.norm(reach, axis=-1) * (1 + 1e-6)
    steps = np.rint(nodes.axis * HALF).astype(np.int64)
    error = angle_between(unit(steps.astype(np.float64)), nodes.axis)
    cos_o = np.cos(np.minimum(nodes.theta_o + error, np.pi))
    cones = [np.floor((cos + 1) / 2 * CONE_STEPS).astype(np.uint32) for cos in (cos_o, np.cos(nodes.theta_e))]
    x, y, z = (np.moveaxis(steps, -1, 0) + HALF).astype(np.uint32)
    words = np.empty((*links.shape, WORDS), np.uint32)
    words[..., :3] = center.view(np.uint32)
    words[..., 3] = np.nextafter(radius.astype(np.float32), np.float32(np.inf)).view(np.uint32)
    words[..., 4] = (nodes.intensity * scale).astype(np.float32).view(np.uint32)
    words[..., 5] = x | y << np.uint32(AXIS_BITS) | z << np.uint32(2 * AXIS_BITS)
    words[..., 6] = cones[0] | cones[1] << np.uint32(16)
    words[..., 7] = links
    return words


@dataclass
class Child:
    """One child, as a kernel reads it."""

    words: Any

    @property
    def link(self) -> UInt32:
        """The number of the child's record, or of its light: see `Tree.links`."""
        return self.words[7]

    def importance(self, p: Point3f, n: Vector3f | None, oriented: bool) -> Float:
        """An estimate of the child's light at `p`; 0 only if there can't be any.

        intensity cos(theta_p) cos(theta_r) / dist^2: theta_p from the cone of normals, theta_r from the surface normal,
        on either side. If not `oriented`, all lights shine alike in all directions.
        """
        radius, intensity = float_in(self.words[3]), float_in(self.words[4])
        to_p = p - Point3f(*(float_in(word) for word in self.words[:3]))
        dist_squared = maximum(dr.squared_norm(to_p), Float(1e-30))
        inv_dist = dr.rsqrt(dist_squared)
        # The half angle of the bounding sphere. Within the sphere all is possible.
        sin_b = radius * inv_dist
        inside, cos_b = sin_b >= 1, sine_of(sin_b)
        result = intensity * dr.rcp(maximum(dist_squared, NEAR * dr.square(radius)))
        reaches = intensity > 0

        if oriented:
            axis = Vector3f(*(number(self.words[5] >> (AXIS_BITS * k), MASK) - HALF for k in range(3)))
            cos_o = dr.fma(number(self.words[6], 0xFFFF), 2 / CONE_STEPS, -1)
            cos_e = dr.fma(number(self.words[6] >> 16, 0xFFFF), 2 / CONE_STEPS, -1)
            cos_w = dr.dot(axis, to_p) * (inv_dist * dr.rsqrt(dr.squared_norm(axis)))
            sin_w, sin_o = sine_of(cos_w), sine_of(cos_o)
            # The angle from the axis, less theta_o, at the centre; then less the half angle.
            within = cos_w >= cos_o
            cos_x = dr.select(within, 1, dr.fma(cos_w, cos_o, sin_w * sin_o))
            sin_x = dr.select(within, 0, dr.fma(sin_w, cos_o, -cos_w * sin_o))
            cos_p = dr.select(inside | (cos_x >= cos_b), 1, dr.fma(cos_x, cos_b, sin_x * sin_b))
            reaches &= cos_p > cos_e - SLACK
            result *= maximum(typical(cos_x, cos_p), Float(LEAST_EMISSION))

        if n is not None:
            cos_i = dr.abs(dr.dot(n, to_p)) * inv_dist
            cos_r = dr.fma(cos_i, cos_b, sine_of(cos_i) * sin_b)
            cos_r = dr.select(inside | (cos_i >= cos_b), 1, cos_r)
            result *= maximum(typical(cos_i, cos_r), Float(LEAST_RECEPTION))
        return dr.select(reaches, result, 0)


def typical(at_center: Float, largest: Float) -> Float:
    """The cosine that a node is judged by, from that at its centre and the largest one in its sphere."""
    return dr.fma(maximum(at_center, Float(0)), 1 - BOUND_WEIGHT, largest * BOUND_WEIGHT)


def children(words: UInt32, node: UInt32) -> tuple[Child, Child]:
    """Load both children of an inner node, by two packets."""
    left: Any = dr.gather(ArrayXu, words, node * 2, shape=(WORDS, 1))
    right: Any = dr.gather(ArrayXu, words, node * 2 + 1, shape=(WORDS, 1))
    return Child(list(left)), Child(list(right))


def sine_of(cos: Float) -> Float:
    """The sine of an angle in [0, pi] from its cosine, or the other way round."""
    return dr.sqrt(maximum(dr.fma(-cos, cos, 1), Float(0)))


def number(word: UInt32, mask: int) -> Float:
    """The lowest bits of a word as a number: signed integers convert faster."""
    return Float(Int32(word & mask))
