"""Densities on the unit cube that are learnt from samples: where indirect silhouettes matter.

They guide the samples of `djpt.ad.projective`, after Z. Zhang, N. Roussel and W. Jakob, "Projective Sampling for
Differentiable Rendering of Geometry", ACM Trans. Graph. 42(6), 2023, section 5.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.distributions.distributions_1d import DiscreteDistribution
from djpt.errors import RenderError
from djpt.integrators.projective.spread import spread
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f, backend

__all__ = [
    "UNIFORM_SHARE",
    "BaseGuidingDistr",
    "GridDistr",
    "OcSpaceDistr",
    "UniformDistr",
    "effective_number",
    "padded",
    "places_of",
]

Array3u = backend.Array3u

UNIFORM_SHARE = 0.1
"""The `uniform_share` of the guides of integrators."""


class BaseGuidingDistr:
    """The contract: a density on the unit cube."""

    def sample(self, sampler: Any) -> tuple[Vector3f, Float]:
        """A point per lane of the sampler, and the inverse of its density."""
        raise NotImplementedError(f"{type(self).__name__} needs a method sample(sampler)")


def shares(mass: Float, volume: Float, uniform_share: float) -> Float:
    """The probabilities of boxes: by mass, except for a share by volume, which finds what no mass is known of.

    Args:
        mass: the mass of each box.
        volume: its share of the cube.
        uniform_share: the probability of the choice by volume; with 0 boxes without mass are never chosen.
    """
    return mass if uniform_share == 0 else dr.fma(mass / dr.sum(mass), 1 - uniform_share, volume * uniform_share)


def effective_number(mass: Float) -> float:
    """The number of points in proportion to m that are as good as points of masses m; 0 without mass.

    It is the square of the sum over the sum of the squares.
    """
    values = np.asarray(mass, np.float64)  # summed up in one order, whatever the number of threads
    return float(values.sum() ** 2 / np.square(values).sum()) if values.any() else 0.0


def padded(mass: Float) -> Float:
    """Probabilities, followed by zeros: kernels know how many there are."""
    return joined([mass], room(dr.width(mass)))


def room(count: int) -> int:
    """The smallest power of 16 that isn't less: the size of tables whose lengths vary from one image to the next.

    Powers of two would often lie between two of these lengths, and kernels of tens of thousands of operations would be
    compiled again.
    """
    return 16 ** (-(-max(count - 1, 0).bit_length() // 4))


def joined(parts: Sequence[Float], size: int) -> Float:
    """Arrays one after the other, filled up with zeros to a size: by one kernel, whatever their widths."""
    result, start = dr.zeros(Float, size), 0
    for part in parts:
        dr.scatter(result, part, dr.arange(UInt32, dr.width(part)) + dr.opaque(UInt32, start))
        start += dr.width(part)
    return result


class UniformDistr(BaseGuidingDistr):
    """The density 1."""

    def sample(self, sampler: Any) -> tuple[Vector3f, Float]:
        even = spread(sampler)
        return Vector3f(even.x, even.y, sampler.next_1d()), Float(1)


class GridDistr(BaseGuidingDistr):
    """A density that is constant in each cell of a grid.

    Args:
        resolution: the cells along x, y, z.
        clamp_mass_thres: cells with less than this fraction of all mass have none.
        scale_mass: masses are raised to the power 1 - scale_mass.
        debug_logs: accepted; nothing is logged.
        uniform_share: the probability with which all cells are sampled alike: above 0 estimates have no bias.
    """

    def __init__(
        self,
        resolution: Sequence[int],
        clamp_mass_thres: float,
        scale_mass: float = 0.0,
        debug_logs: bool = False,
        uniform_share: float = 0.0,
    ) -> None:
        self.resolution = [int(n) for n in resolution]
        self.num_cells = self.resolution[0] * self.resolution[1] * self.resolution[2]
        self.clamp_mass_thres, self.scale_mass, self.uniform_share = clamp_mass_thres, scale_mass, uniform_share
        self.pmf = DiscreteDistribution()

    def get_cell_array(self, index_array_: UInt32) -> Any:
        """The three indices of cells by number; z varies fastest."""
        index, (_, ny, nz) = UInt32(index_array_), self.resolution
        x = index // (ny * nz)
        y = index // nz - x * ny
        return Array3u(x, y, index - (x * ny + y) * nz)

    def sample_to_cell_idx(self, sample: Point3f, active: Bool | bool = True) -> UInt32:
        """The numbers of the cells that points lie in; 0 on inactive lanes."""
        cell = Array3u(*(UInt32(x * n) for x, n in zip(sample, self.resolution, strict=True)))
        _, ny, nz = self.resolution
        return dr.select(active, (cell.x * ny + cell.y) * nz + cell.z, 0)

    def set_mass(self, mass: Float) -> None:
        """Set the mass of each cell, (num_cells,)."""
        if self.clamp_mass_thres > 0:
            mass = dr.select(mass < self.clamp_mass_thres * dr.sum(mass), 0, mass)
        if self.scale_mass > 0:
            mass = Float(dr.power(mass, 1 - self.scale_mass))
        self.pmf = DiscreteDistribution(shares(mass, Float(1 / self.num_cells), self.uniform_share))

    def sample(self, sampler: Any) -> tuple[Vector3f, Float]:
        inside = three(sampler)
        index, chance = self.pmf.sample_pmf(spread(sampler).x)
        return self._in_cell(index, inside), dr.select(chance > 0, dr.rcp(chance * self.num_cells), 0)

    def random_cell_sample(self, sampler: Any) -> Vector3f:
        """A random point in each cell, in the order of their numbers; the sampler has a lane per cell."""
        return self._in_cell(dr.arange(UInt32, self.num_cells), three(sampler))

    def _in_cell(self, index: UInt32, inside: Vector3f) -> Vector3f:
        return (Vector3f(self.get_cell_array(index)) + inside) / Vector3f(*self.resolution)

    def __repr__(self) -> str:
        return f"GridDistr[resolution={self.resolution}, num_cells={self.num_cells}]"


class OcSpaceDistr(BaseGuidingDistr):
    """A density that is constant in each leaf of an octree.

    The tree is refined until a leaf holds a single sample. The mass of a leaf is then estimated from random points.

    Args:
        max_depth: the levels of the tree at most.
        max_leaf_count: the leaves at most.
        extra_spc: random points per leaf.
        eval_indirect_integrand_handle: (points, sampler) -> (value, ..): the function that the density imitates.
        clamp_input_mass_thres: accepted; samples count if their mass exceeds the attribute `mass_contruction_thres`.
        clamp_mass_thres: leaves with less than this fraction of all mass have none.
        prepartition_x_slices: the slabs along x that the cube is first cut into.
        scatter_inc: accepted, but has no effect.
        scale_mass: masses are raised to the power 1 - scale_mass.
        debug_logs: accepted; nothing is logged.
        uniform_share: the probability with which leaves are chosen by volume alone: above 0 estimates have no bias.
    """

    def __init__(
        self,
        max_depth: int,
        max_leaf_count: int,
        extra_spc: int,
        eval_indirect_integrand_handle: Callable[..., Any],
        clamp_input_mass_thres: float,
        clamp_mass_thres: float,
        prepartition_x_slices: int,
        scatter_inc: bool = False,
        scale_mass: float = 0.0,
        debug_logs: bool = False,
        uniform_share: float = 0.0,
    ) -> None:
        self.uniform_share = uniform_share
        self.max_depth, self.max_leaf_count, self.extra_spc = max_depth, max_leaf_count, extra_spc
        self.eval_indirect_integrand_handle = eval_indirect_integrand_handle
        self.prepartition_x_slices = prepartition_x_slices
        self.clamp_input_mass_thres, self.clamp_mass_thres = clamp_input_mass_thres, clamp_mass_thres
        self.scatter_inc, self.scale_mass, self.debug_logs = scatter_inc, scale_mass, debug_logs
        self.mass_contruction_thres = 0.0
        self.pmf = DiscreteDistribution()
        self.lower, self.upper = Point3f(0), Point3f(1)

    # ---- boxes in a buffer, six numbers each ------------------------------------------------

    @staticmethod
    def aabbs(buffer: Float, node_idx: UInt32) -> tuple[Point3f, Point3f]:
        """The lowest and the highest corner of boxes."""
        return dr.gather(Point3f, buffer, 2 * node_idx), dr.gather(Point3f, buffer, 2 * node_idx + 1)

    @staticmethod
    def split_offset(x_offset: Any, y_offset: Any, z_offset: Any) -> Any:
        """The number of an octant; the offsets are 0 in the lower half and 1 in the upper."""
        return x_offset + 2 * y_offset + 4 * z_offset

    @staticmethod
    def split(buffer: Float, aabb_min: Point3f, aabb_max: Point3f, aabb_middle: Point3f, node_idx: UInt32) -> None:
        """Write the octants of N boxes to a buffer: octant k of box i is number k N + i."""
        # Numbers that are written into a kernel make it a new one for each tree.
        count = dr.opaque(UInt32, dr.width(node_idx))
        for x, y, z in itertools.product((0, 1), repeat=3):
            low = Point3f(*((aabb_min, aabb_middle)[k][axis] for axis, k in enumerate((x, y, z))))
            high = Point3f(*((aabb_middle, aabb_max)[k][axis] for axis, k in enumerate((x, y, z))))
            place = 2 * (node_idx + OcSpaceDistr.split_offset(x, y, z) * count)
            dr.scatter(buffer, low, place)
            dr.scatter(buffer, high, place + 1)

    # ---- the tree ---------------------------------------------------------------------------

    def construct_octree(self, points: Point3f, log: bool = False) -> tuple[Point3f, Point3f]:
        """The lowest and the highest corners of the leaves of a tree about some points.

        Raises:
            RenderError: there are more leaves than `max_leaf_count`.
        """
        return self._leaves(points)[:2]

    def _leaves(self, points: Point3f) -> tuple[Point3f, Point3f, UInt32]:
        """The corners of the leaves, and the number of the leaf that each point lies in."""
        count = self.prepartition_x_slices
        edge = dr.arange(Float, count) / count
        low = Point3f(edge, dr.zeros(Float, count), dr.zeros(Float, count))
        high = Point3f(edge + 1 / count, dr.ones(Float, count), dr.ones(Float, count))
        node = dr.minimum(UInt32(points.x * count), count - 1)
        active = dr.full(Bool, True, dr.width(points))
        leaves: list[tuple[Point3f, Point3f]] = []
        leaf, total = dr.zeros(UInt32, dr.width(points)), 0
        for level in itertools.count(1):
            middle, buffer = 0.5 * (low + high), dr.zeros(Float, 48 * count)
            self.split(buffer, low, high, middle, dr.arange(UInt32, count))
            above = points > dr.gather(Point3f, middle, node, active)
            octant = self.split_offset(*(dr.select(axis, UInt32(1), 0) for axis in above))
            child = node + dr.opaque(UInt32, count) * octant
            population = dr.zeros(UInt32, 8 * count)
            dr.scatter_add(population, UInt32(1), child, active, mode=dr.ReduceMode.Local)
            is_leaf = (population <= 1) & (level >= 3) | (level >= self.max_depth)
            dr.eval(buffer, child, is_leaf)

            chosen, others = places_of(is_leaf), places_of(~is_leaf)
            if dr.width(chosen):
                leaves.append(self.aabbs(buffer, chosen))
                number = dr.cumsum(dr.select(is_leaf, UInt32(1), 0)) + dr.opaque(UInt32, total) - 1
                arrived = active & dr.gather(Bool, is_leaf, child, active)
                leaf = dr.select(arrived, dr.gather(UInt32, number, child, active), leaf)
            total += dr.width(chosen)
            count = dr.width(others)
            if total + 8 * count > self.max_leaf_count:
                raise RenderError(
                    f"OcSpaceDistr: the octree needs more than {self.max_leaf_count} leaves: raise max_leaf_count, or "
                    "take less than max_depth"
                )
            if count == 0:
                break
            low, high = self.aabbs(buffer, others)
            # The others move up to take the places of leaves.
            active &= ~dr.gather(Bool, is_leaf, child, active)
            rank = dr.cumsum(dr.select(is_leaf, UInt32(0), 1)) - 1
            node = dr.gather(UInt32, rank, child, active)
            dr.eval(low, high, node, active, leaf)
        low, high = (
            Point3f(*(joined([p[axis] for p in ends], total) for axis in range(3)))
            for ends in zip(*leaves, strict=True)
        )
        return low, high, leaf

    def estimate_mass_in_leaves(
        self, aabb_min: Point3f, aabb_max: Point3f, seed: UInt32 | int, log: bool = False
    ) -> Float:
        """The mean of the imitated function in each leaf, from `extra_spc` random points."""
        return self._values_in_leaves(aabb_min, aabb_max, seed, 1) / dr.opaque(Float, self.extra_spc)

    def _values_in_leaves(self, aabb_min: Point3f, aabb_max: Point3f, seed: UInt32 | int, power: int) -> Float:
        """The sum of a power of the imitated function at `extra_spc` random points of each leaf."""
        from djpt.description.loader import load_dict

        sampler: Any = load_dict({"type": "independent"})
        sampler.seed(0xFFFFFFFF ^ seed, dr.width(aabb_min) * self.extra_spc)
        # Numbers that are written into a kernel make it a new one for each tree.
        number = dr.arange(UInt32, dr.width(aabb_min) * self.extra_spc) // dr.opaque(UInt32, self.extra_spc)
        low, high = dr.gather(Point3f, aabb_min, number), dr.gather(Point3f, aabb_max, number)
        value = self.eval_indirect_integrand_handle(dr.lerp(low, high, three(sampler)), sampler)[0]
        return dr.block_sum(dr.power(dr.max(value), power), self.extra_spc)

    def set_points(self, points: Point3f, mass: Float, seed: UInt32 | int = 0, log: bool = False) -> None:
        """Learn the density from points of the cube and their masses; those of mass 0 don't count.

        Raises:
            RenderError: no point has mass.
        """
        kept = places_of(mass > dr.opaque(Float, self.mass_contruction_thres))
        if not dr.width(kept):
            raise RenderError("OcSpaceDistr: no sample has mass above the threshold: use more samples, or lower it")
        low, high, leaf = self._leaves(dr.gather(Point3f, points, kept))
        if self.uniform_share > 0:
            # Samples vary least if leaves are chosen by the root of the mean square. It counts leaves in which most
            # random points find nothing, and the points themselves know of more such leaves.
            # A kernel that sums up knows the size of the sums.
            total, count = (dr.zeros(Float, room(dr.width(low))) for _ in range(2))
            dr.scatter_add(total, dr.square(dr.gather(Float, mass, kept)), leaf)
            dr.scatter_add(count, Float(1), leaf)
            number = dr.arange(UInt32, dr.width(low))
            known = self._values_in_leaves(low, high, seed, 2) + dr.gather(Float, total, number)
            mean = dr.sqrt(known / (dr.opaque(Float, self.extra_spc) + dr.gather(Float, count, number)))
        else:
            mean = self.estimate_mass_in_leaves(low, high, seed, log)
        size = high - low
        box_mass = mean * size.x * size.y * size.z
        # Where there is hardly any mass, a sample would have an enormous weight.
        valid = (mean >= self.clamp_mass_thres * dr.sum(mean)) & (box_mass > 0)
        if not dr.any(valid):
            raise RenderError("OcSpaceDistr: no leaf has mass: use more samples")
        box_mass = dr.select(valid, box_mass, 0)
        if self.scale_mass > 0:
            box_mass = Float(dr.power(box_mass, 1 - self.scale_mass))
        self.pmf = DiscreteDistribution(padded(shares(box_mass, size.x * size.y * size.z, self.uniform_share)))
        self.lower, self.upper = low, high

    def sample(self, sampler: Any) -> tuple[Vector3f, Float]:
        index, chance = self.pmf.sample_pmf(spread(sampler).x)
        low, high = dr.gather(Point3f, self.lower, index), dr.gather(Point3f, self.upper, index)
        size = high - low
        inverse = dr.select(chance > 0, size.x * size.y * size.z * dr.rcp(chance), 0)
        return Vector3f(dr.lerp(low, high, three(sampler))), inverse

    def __repr__(self) -> str:
        return f"OcSpaceDistr[leaves={0 if self.pmf.empty() else dr.width(self.lower)}]"


def places_of(mask: Bool) -> UInt32:
    """The indices of the entries that are true."""
    found: Any = dr.compress(mask)
    return UInt32(found)


def three(sampler: Any) -> Vector3f:
    """Three uniform numbers."""
    return Vector3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
