"""The cache of light in media: what matter scatters at each place, learned from paths that went on to the light.

A path that is scattered at x, with the throughput b there, and finds the radiance L from then on, has estimated the
light S = L / b that x sends towards the vertex before. If matter scatters evenly S is the same in all directions, and
in dense matter it changes little within a free path: its mean over a cell says what other paths would find.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import drjit as dr
import numpy as np

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.integrators.base import PathIntegrator, Vertex
from djpt.integrators.guiding.training import Lane, follow
from djpt.jit.kernels import as_float, maximum, minimum, own_copy, own_floats, while_loop
from djpt.jit.types import Array4f, Bool, Color3f, Float, Int64, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.media.base import Medium
    from djpt.scene.scene import Scene

__all__ = ["LightCache", "LightCells", "ScatteringVertex", "learned"]

SIDES = 12, 32
"""The least and the largest number of cells along an edge of a medium's box."""

WIDEST = 1.0
"""The largest width of a cell, in free paths."""

DIGITS = 24
"""Binary digits behind the point of the sums, whole numbers whose order doesn't matter."""

MOST = 2.0**12
"""The largest summand, in units of the lights' brightness."""

REMEMBERED = 64
"""The number of vertices that a path remembers."""

VISITS = 16
"""The visits from which on a cell's mean is used."""


class LightCells:
    """The cells of media: the box about the shapes that have a medium inside is cut along each axis.

    Cells are about as wide as a free path, but there are at least `SIDES[0]` along an axis, and at most `SIDES[1]`.
    Paths end near the surface of a body, and others leave most of their light deeper: where cells would be wider than
    `WIDEST` free paths, their mean would be too dark. Such a medium has none, nor has one that is inside of no shape,
    such as fog that fills all space.
    """

    def __init__(self, scene: Scene) -> None:
        media = scene.media
        low = np.full((media.vacuum + 1, 3), np.inf)
        high = -low
        for shape in scene.geometry.contents.shapes:
            medium = shape.interior_medium()
            if medium is not None:
                number, corners = media.number(medium), shape.world_box()
                low[number], high[number] = np.minimum(low[number], corners[0]), np.maximum(high[number], corners[1])
        edges = high - low
        bounded = np.isfinite(edges).all(axis=1)
        free_paths = np.where(bounded[:, None], edges, 0) * [[densest(m)] for m in [*media.plugins, None]]
        sides = np.clip(np.ceil(free_paths), *SIDES)
        bounded &= (free_paths <= WIDEST * sides).all(axis=1)
        self.any = bool(bounded.any())
        """False if no medium has cells."""
        first = np.concatenate([[0], np.cumsum(sides.prod(axis=1))])
        self.count = int(first[-1])
        self._low = own_floats(np.where(bounded[:, None], low, np.inf).astype(np.float32))
        scale = sides / np.where(bounded[:, None], np.maximum(edges, 1e-30), 1)
        self._scale, self._sides = (own_floats(table.astype(np.float32)) for table in (scale, sides))
        self._first = own_copy(first[:-1].astype(np.uint32))

    def at(self, medium: UInt32, p: Point3f, offset: Any, active: Bool) -> tuple[UInt32, Bool]:
        """The number of the cell of a point, moved by an `offset` in units of cells; False where there is none.

        Rounding may have left a point beside its box.
        """
        tables = (self._low, self._scale, self._sides)
        low, scale, sides = (dr.gather(Vector3f, table, medium, active) for table in tables)
        place, half = (p - low) * scale, sides / 2
        there = active & (low.x < dr.inf) & (dr.max(dr.abs(place - half) - half) < 1)
        places = zip(place + offset, sides, strict=True)
        x, y, z = (UInt32(minimum(maximum(c, 0.0), side - 1.0)) for c, side in places)
        cell = (z * UInt32(sides.y) + y) * UInt32(sides.x) + x
        return dr.select(there, dr.gather(UInt32, self._first, medium, active) + cell, 0), there


def densest(medium: Medium | None) -> float:
    """The largest extinction of a medium; 0 for the vacuum."""
    if medium is None:
        return 0.0
    at = MediumInteraction3f.on(Ray3f(Point3f(0), Vector3f(0, 0, 1)), Float(0))
    return float(np.max(dr.detach(medium.get_majorant(at)).numpy()))


@dataclass
class LightCache:
    """The light that media scatter, cell by cell."""

    cells: LightCells
    table: Float
    """Red, green and blue of each cell, and 1 if they are known."""

    def scattered(self, medium: UInt32, p: Point3f, u: Vector3f, active: Bool) -> tuple[Color3f, Bool]:
        """The light that is scattered at a point, by three uniform numbers; False where it isn't known.

        The numbers move the point by up to half a cell: the mean is that of linear interpolation.
        """
        cell, there = self.cells.at(medium, p, Vector3f(0), active)
        moved, _ = self.cells.at(medium, p, u - 0.5, active)
        own, near = (dr.gather(Array4f, self.table, i, there) for i in (cell, moved))
        light = dr.select(near.w > 0, near, own)
        return Color3f(light.x, light.y, light.z), there & (own.w > 0)


@dataclass
class ScatteringVertex(Vertex):
    """A vertex whose light a cache may know, or learn."""

    cell: UInt32 = field(default_factory=UInt32)
    """The cell of the vertex."""
    in_cell: Bool = field(default_factory=Bool)
    """True where light is scattered in a cell."""
    throughput: Color3f = field(default_factory=Color3f)
    """That of the path, with what this vertex leaves: what the cell's light is to be multiplied by."""


@dataclass
class Note:
    """A vertex, as a path remembers it."""

    cell: UInt32
    throughput: Color3f
    before: Color3f
    """The radiance that the path has found since the vertex noted before."""


def learned(
    integrator: PathIntegrator, scene: Scene, cells: LightCells, sampler: SampleStream, ray: Ray3f, unit: float
) -> LightCache:
    """The cache by one path per lane.

    Args:
        integrator: One whose vertices are `ScatteringVertex`.
        scene: The scene.
        cells: The cells.
        sampler: Random numbers.
        ray: Camera rays.
        unit: A usual radiance.
    """
    visits, sums = dr.zeros(UInt32, cells.count), dr.zeros(Int64, 3 * cells.count)
    dr.eval(visits, sums)

    def note(lane: Lane, v: ScatteringVertex, arrived: Color3f, reflected: Color3f) -> tuple[Note, Bool, Color3f]:
        # The radiance of a lane is what it has found since the last note.
        noted = v.in_cell & (lane.count < REMEMBERED)
        return Note(v.cell, v.throughput, arrived), noted, dr.select(noted, 0, arrived) + reflected

    end = follow(integrator, scene, sampler, ray, dr.alloc_local(Note, REMEMBERED), note, "light cache")
    scale = dr.rcp(as_float(unit))

    def add(left: UInt32, since: Color3f, notes: Any) -> tuple[UInt32, Color3f, Any]:
        left = left - 1
        note = notes.read(left)
        for channel in range(3):
            b = note.throughput[channel]
            light = minimum(dr.select(b > 0, since[channel] * dr.rcp(b) * scale, 0), MOST)
            dr.scatter_add(sums, Int64(dr.round(light * 2.0**DIGITS)), note.cell * 3 + channel)
        dr.scatter_add(visits, UInt32(1), note.cell)
        return left, since + note.before, notes

    last, _, _ = while_loop(
        (end.count, end.radiance, end.notes), lambda left, since, notes: left > 0, add, label="light cache notes"
    )
    dr.eval(last, visits, sums)
    seen = visits.numpy().astype(np.float64)[:, None]
    mean = sums.numpy().reshape(-1, 3) * (unit / 2.0**DIGITS) / np.maximum(seen, 1)
    table = np.concatenate([mean, seen >= VISITS], axis=1)
    return LightCache(cells, own_floats(table.astype(np.float32)))
