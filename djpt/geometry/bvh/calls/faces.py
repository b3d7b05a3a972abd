"""The flat faces of scenes with few triangles, as tables that `djpt.geometry.bvh.calls.sweep` reads.

A face is a triangle, or a convex quadrilateral of two that share an edge, in one plane and one mesh. It is the part of
its plane where three or four half-spaces overlap.

The tables hold, for each face, the numbers of TEST and those of FINISH. Planes are four numbers: a normal n and an
offset c, for n . p + c. What is inside has positive values.

======  =====  =====================================================================================
part    words  contents
======  =====  =====================================================================================
TEST    21     the face's own plane; the half-spaces of its edges, in units of length; all bits set if the
               face belongs to a light
FINISH  28     the half-space of the first triangle; for both triangles the weights of their second
               and third corners as planes; the numbers of both, counted from the first record
======  =====  =====================================================================================

Where a ray meets a plane is known up to rounding errors, so that it could pass between two faces with a common edge.
Faces reach beyond their edges by a margin that is larger than these errors. It is measured across the ray: the more a
ray grazes a face, the more its point in the plane moves by an error of the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from djpt.geometry.bvh.steps.records import EMITS

__all__ = ["FEW", "FINISH_BYTES", "TEST_BYTES", "Faces"]

TEST, FINISH = 21, 28
TEST_BYTES, FINISH_BYTES = 4 * TEST, 4 * FINISH

FEW = 64
"""The most faces that are swept."""

MARGIN = 2.0**-21
"""The margin of edges, in units of the diagonal of everything."""

SMALLEST = 2.0**-8
"""The least height of faces in the same units: on smaller ones weights would be imprecise."""

FLAT = 2.0**-22
"""How far the fourth corner of a quadrilateral may be from the plane of the others, in the same units."""

Points = NDArray[np.float64]


@dataclass
class Faces:
    """The tables of a scene."""

    tests: NDArray[np.uint32]
    """(N, TEST)."""
    finishes: NDArray[np.uint32]
    """(N, FINISH)."""
    margin: float
    """How far faces reach beyond their edges."""

    def header(self, row: int) -> list[int]:
        """The words of a tree's header from FACES_WORD on, if the tables begin at a row."""
        return [row, len(self.tests), int(np.float32(self.margin).view(np.uint32))]

    @property
    def rows(self) -> NDArray[np.uint32]:
        """Both tables in rows of a tree's memory, (R, 8)."""
        words = np.concatenate([self.tests.ravel(), self.finishes.ravel()])
        return np.pad(words, (0, -len(words) % 8)).reshape(-1, 8)

    @staticmethod
    def of(corners: NDArray[np.float32], labels: NDArray[np.uint32], diagonal: float) -> Faces | None:
        """The faces of triangles with some corners (F, 3, 3), or None if they are too many or too small.

        Triangles with different `labels`, (F,), are never joined.
        """
        if len(corners) > 2 * FEW:
            return None
        points = corners.astype(np.float64)
        polygons = joined(points, labels, diagonal)
        if len(polygons) > FEW or any(not polygon.height() > SMALLEST * diagonal for polygon in polygons):
            return None
        tests = np.array([polygon.test() for polygon in polygons], np.float32).view(np.uint32)
        emits = np.array([labels[polygon.triangles[0][0]] & EMITS for polygon in polygons])
        return Faces(
            np.column_stack([tests, np.where(emits, ~np.uint32(0), np.uint32(0))]),
            np.array([polygon.finish() for polygon in polygons]),
            MARGIN * diagonal,
        )


@dataclass
class Polygon:
    """A convex polygon of one or two triangles."""

    corners: Points
    """(3, 3) or (4, 3): those of the first triangle, in its order but for a rotation, with the fourth before the last.
    """
    triangles: Sequence[tuple[int, Points]]
    """The number of each triangle, and its corners (3, 3) in their own order."""

    def half_spaces(self) -> Points:
        """The half-space of each edge, in units of length, (3 or 4, 4)."""
        normal = np.cross(self.corners[1] - self.corners[0], self.corners[-1] - self.corners[0])
        ends = np.roll(self.corners, -1, axis=0)
        return np.array([half_space(normal, *edge) for edge in zip(self.corners, ends, strict=True)])

    def height(self) -> float:
        """The least distance of a corner from an edge that doesn't end there; not positive if it isn't convex."""
        values = self.half_spaces() @ homogeneous(self.corners).T
        count = len(values)
        others = [values[edge, (edge + k) % count] for edge in range(count) for k in range(2, count)]
        return float(min(others))

    def test(self) -> Points:
        """The planes of TEST."""
        a, b, c = self.triangles[0][1]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        edges = self.half_spaces()
        # The fourth half-space of a triangle is its third again.
        edges = edges[[0, 1, 2, len(edges) - 1]]
        return np.concatenate([normal, [-normal @ a], edges.ravel()])

    def finish(self) -> NDArray[np.uint32]:
        """The numbers of FINISH."""
        (first, a), (second, b) = self.triangles[0], self.triangles[-1]
        normal = np.cross(self.corners[1] - self.corners[0], self.corners[-1] - self.corners[0])
        whole = len(self.triangles) == 1
        side = np.array([0, 0, 0, 1]) if whole else half_space(normal, self.corners[1], self.corners[-1])
        side = side if whole or side @ homogeneous(self.corners[:1])[0] > 0 else -side
        planes = np.concatenate([side, weights(a), weights(b)]).astype(np.float32)
        return np.concatenate([planes.view(np.uint32), np.array([first, second] + [0] * 6, np.uint32)])


def half_space(normal: Points, start: Points, end: Points) -> Points:
    """What lies to the left of an edge on a plane with some normal, in units of length."""
    inward = np.cross(normal, end - start)
    inward /= max(float(np.linalg.norm(inward)), 1e-300)
    return np.append(inward, -inward @ start)


def weights(corners: Points) -> Points:
    """The weights of the second and third corner of a triangle at points in its plane, as planes, (8,)."""
    planes = []
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    for k in (1, 2):
        plane = half_space(normal, corners[(k + 1) % 3], corners[(k + 2) % 3])
        planes.append(plane / (plane @ homogeneous(corners[k : k + 1])[0]))
    return np.concatenate(planes)


def homogeneous(points: Points) -> Points:
    """Points (N, 3) with a 1 behind each, (N, 4)."""
    return np.pad(points, ((0, 0), (0, 1)), constant_values=1)


def joined(corners: Points, labels: NDArray[np.uint32], diagonal: float) -> list[Polygon]:
    """The faces of triangles, each joined with the first of those before it with which it makes a quadrilateral."""
    numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    polygons: dict[int, Polygon] = {}
    edges: dict[tuple[int, int], tuple[int, int]] = {}
    for i, (triangle, own) in enumerate(zip(corners, numbers, strict=True)):
        polygons[i] = Polygon(triangle, [(i, triangle)])
        for k in range(3):
            start, end = int(own[k]), int(own[(k + 1) % 3])
            j, other = edges.get((end, start), (i, 0))
            if j in polygons and len(polygons[j].triangles) == 1 and labels[i] == labels[j] and j != i:
                a, b, c = np.roll(corners[j], -(other + 2), axis=0)
                quadrilateral = Polygon(np.array([a, b, triangle[(k + 2) % 3], c]), [(j, corners[j]), (i, triangle)])
                if quadrilateral.height() > SMALLEST * diagonal and is_flat(quadrilateral.corners, diagonal):
                    polygons[j] = quadrilateral
                    del polygons[i]
                    break
            edges[start, end] = i, k
    return list(polygons.values())


def is_flat(corners: Points, diagonal: float) -> bool:
    """Whether the corners of a quadrilateral (4, 3) lie in a plane."""
    a, b, c, d = corners
    normal = np.cross(b - a, d - a)
    return float(abs(normal @ (c - a))) <= FLAT * diagonal * float(np.linalg.norm(normal))
