"""The choice of points on meshes, uniform by area, as lights need them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from djpt.jit.types import Float, Point2f, UInt32

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["AreaTable", "square_to_triangle"]


class AreaTable:
    """The running sums of the areas of faces, for one mesh after the other."""

    def __init__(self, meshes: Sequence[Mesh], least_steps: int = 0) -> None:
        """Build the table; `least_steps` is the number of steps before an edit, lest fewer faces need a new kernel."""
        sums = [np.cumsum(mesh.face_areas()).astype(np.float32) for mesh in meshes]
        self._sums = Float(np.concatenate(sums)) if sums else Float(1)
        # Unevaluated arithmetic would make its inputs a part of kernels.
        dr.make_opaque(self._sums)
        self.steps = max(least_steps, max((len(part) for part in sums), default=1).bit_length())

    def sample(self, first: UInt32, count: UInt32, total: Float, sample: Float) -> tuple[UInt32, Float]:
        """Choose a face with a probability proportional to its area, and stretch the sample for use within it.

        Args:
            first: the set-wide number of the mesh's first face.
            count: the number of its faces.
            total: the area of all of them.
            sample: uniform in [0, 1).

        Returns:
            The number of the face in the mesh, and the stretched sample, uniform in [0, 1) again as in Mitsuba.
        """
        wanted = sample * total
        # The number of faces whose sum lies below, by halving steps; a face without area is never chosen.
        below = UInt32(0)
        for k in reversed(range(self.steps)):
            probe = below + (1 << k)
            inside = probe < count
            value = dr.gather(Float, self._sums, first + probe - 1, inside)
            further = inside & ((value < wanted) | (value == 0)) & (value != total)
            below = dr.select(further, probe, below)
        before = dr.gather(Float, self._sums, first + below - 1, below > 0)
        after = dr.gather(Float, self._sums, first + below)
        return below, (wanted - before) * dr.rcp(after - before)


def square_to_triangle(sample: Point2f) -> tuple[Float, Float]:
    """Barycentric weights of the second and third corner, uniform in area."""
    t = dr.safe_sqrt(1 - sample.x)
    return 1 - t, t * sample.y
