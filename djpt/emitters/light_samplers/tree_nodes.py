"""The tree of lights in memory, and what kernels estimate from a node.

An inner node is a record of 16 words, 64 bytes, with both of its children, 8 words each:

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
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.emitters.light_samplers.tree_build import Lights, Tree, angle_between, unit
from djpt.jit.kernels import float_in, maximum, own_copy
from djpt.jit.types import ArrayXu, Float, Int32, Point3f, UInt32, Vector3f

__all__ = ["Child", "children", "pack"]

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
