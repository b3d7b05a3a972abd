"""Emitters by their estimated light at a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np

from djpt.distributions.discrete import Discrete
from djpt.emitters.base import Emitter
from djpt.emitters.light_samplers.sampling import LightSampler
from djpt.emitters.light_samplers.tree_build import LEAF, Lights, build, children, pack
from djpt.errors import SceneError
from djpt.jit.kernels import own_copy, while_loop
from djpt.jit.types import Float, Point3f, UInt32, Vector3f
from djpt.samplers.seeds import sample_tea_32

__all__ = ["TreeLightSampler"]

NOWHERE = 0xFFFFFFFF
"""In place of a link: no emitter can be chosen."""

FROM_INFINITY = 0x40000000
"""In the place of an emitter from infinity: the other bits are its number among those."""

PLACE = FROM_INFINITY - 1


@dataclass
class Descent:
    """A lane's way from the root to a leaf: loop state."""

    link: UInt32
    probability: Float
    u: Float


class TreeLightSampler(LightSampler):
    """Emitters by descending a tree of lights, at every node to a child in proportion to its importance.

    Importance is estimated from a node's bounds for the point and the normal: see
    `djpt.emitters.light_samplers.tree_build`. Light from infinity isn't in the tree: each such emitter, and the tree
    as a whole, are chosen by their `sampling_weight` (for the tree: the mean). Emitters whose power or weight is 0 are
    never chosen.

    A. Conty Estevez and C. Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting", 2018; with one
    random number, reused at every level, as in M. Pharr, W. Jakob and G. Humphreys, "Physically Based Rendering",
    4th ed., 2023, section 12.6.3.
    """

    uses_normal = True

    def __init__(self, emitters: Sequence[Emitter]) -> None:
        """Raises `SceneError` if no emitter can be chosen."""
        super().__init__(emitters)
        bounds = [emitter.bounds_in_time() for emitter in emitters]
        weights = np.array([emitter.sampling_weight() for emitter in emitters])
        places = np.full(self.count + 1, NOWHERE, np.uint32)

        from_infinity = [i for i, b in enumerate(bounds) if b is None]
        near = [(i, b) for i, b in enumerate(bounds) if b is not None and b.power * weights[i] > 0]
        shares = [float(weights[[i for i, _ in near]].mean()) if near else 0.0]
        shares += [weights[i] if emitters[i].power() > 0 else 0.0 for i in from_infinity]
        if not sum(shares) > 0:
            raise SceneError("no emitter can be chosen: all sampling weights times powers are 0")
        places[from_infinity] = FROM_INFINITY + np.arange(len(from_infinity), dtype=np.uint32)

        if near:
            numbers = np.array([i for i, _ in near])
            lights = Lights.of([b for _, b in near], weights[numbers])
            total = lights.intensity.sum()
            if not np.isfinite(total):
                raise SceneError("no emitter can be chosen: a power is infinite")
            tree = build(lights)
            leaf = tree.links >= LEAF
            tree.links[leaf] = numbers[tree.links[leaf] - LEAF] + LEAF
            places[numbers] = tree.rank
            root = tree.root if tree.root < LEAF else int(numbers[0]) + LEAF
            self._words = pack(tree, 1 / total)
            self._root = dr.opaque(UInt32, root)
        else:
            self._words, self._root = own_copy(np.zeros((1, 16), np.uint32)), dr.opaque(UInt32, NOWHERE)
        self._places = own_copy(places)
        # Of those without power as well: an edit of that must not change the code.
        self._oriented = any(b.theta_o < np.pi for b in bounds if b is not None)
        # What is structure must not follow from powers, which edits change.
        self._groups = None
        if from_infinity:
            self._groups = Discrete(np.array(shares))
            self._from_infinity = own_copy(np.array(from_infinity, np.uint32))

    def choose(self, p: Point3f, n: Vector3f | None, u: Float) -> tuple[UInt32, Float, Float]:
        start = Descent(UInt32(self._root), Float(1), Float(u))
        group, inverse = UInt32(0), Float(1)
        if self._groups is not None:
            group, inverse, start.u = self._groups.choose(u)
            start.link = dr.select(group == 0, start.link, NOWHERE)

        def step(at: Descent) -> tuple[Descent]:
            left, right = children(self._words, at.link)
            a, b = (child.importance(p, n, self._oriented) for child in (left, right))
            total = a + b
            threshold = at.u * total
            # Rounding must not lead to a child of importance 0.
            to_left = (threshold < a) | ~(b > 0)
            mine = dr.select(to_left, a, b)
            link = dr.select(to_left, left.link, right.link)
            u = dr.select(to_left, threshold, threshold - a) * dr.rcp(mine)
            onward = Descent(link, at.probability * (mine * dr.rcp(total)), u)
            return (dr.select(mine > 0, onward, Descent(UInt32(NOWHERE), Float(0), at.u)),)

        (end,) = while_loop((start,), lambda at: at.link < LEAF, step, label="light tree")
        found = (end.link != NOWHERE) & (end.probability > 0)
        index = dr.select(found, end.link - LEAF, 0)
        tree_inverse = dr.select(found, dr.rcp(end.probability), 0)
        if self._groups is not None:
            far = group != 0
            infinite = dr.gather(UInt32, self._from_infinity, dr.select(far, group - 1, 0))
            index, inverse = dr.select(far, infinite, index), inverse * dr.select(far, 1, tree_inverse)
        else:
            inverse = tree_inverse
        return index, inverse, refined(u, end.u, inverse)

    def probability(self, p: Point3f, n: Vector3f | None, index: UInt32) -> Float:
        place = dr.gather(UInt32, self._places, dr.select(index < self.count, index, self.count))
        result = Float(1)
        link = UInt32(self._root)
        in_tree = place < FROM_INFINITY
        if self._groups is not None:
            far = ~in_tree & (place != NOWHERE)
            result = self._groups.probability(dr.select(far, (place & PLACE) + 1, 0))
            in_tree |= far
            link = dr.select(far, NOWHERE, link)

        def step(link: UInt32, probability: Float) -> tuple[UInt32, Float]:
            left, right = children(self._words, link)
            a, b = (child.importance(p, n, self._oriented) for child in (left, right))
            to_left = place < link
            mine = dr.select(to_left, a, b)
            probability = dr.select(mine > 0, probability * (mine * dr.rcp(a + b)), 0)
            return dr.select(mine > 0, dr.select(to_left, left.link, right.link), NOWHERE), probability

        # Where there is no such emitter, there is no way to go.
        start = dr.select(in_tree, link, NOWHERE)
        _, result = while_loop((start, Float(result)), lambda link, _: link < LEAF, step, label="light tree")
        return dr.select(in_tree, result, 0)


def refined(u: Float, left: Float, inverse: Float) -> Float:
    """The rest of `u` after a choice of some probability, with new bits below those that were used up.

    Random numbers have 23 bits; the choice among 1000 emitters leaves 13, too few to place points by.
    """
    bits, _ = sample_tea_32(dr.reinterpret_array(UInt32, u), dr.reinterpret_array(UInt32, left), 2)  # type: ignore[arg-type]
    fraction = Float(bits >> 8) * 2**-24
    return dr.clip(dr.fma(fraction * 2**-23, inverse, left), 0, 1 - 2**-24)
