"""Media that absorb: bodies of coloured glass.

A BSDF that `absorbs` fills the bodies that it covers with a medium. A ray carries the number of the medium
that it runs through (`Ray3f.medium`). The number changes where a path leaves a surface of such a BSDF, to its
inside or to its outside, and nowhere else. So absorbing bodies may hold any other objects, but not touch or hold
each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import numpy as np

from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.lookup import Members
from djpt.geometry.aggregate import Geometry
from djpt.geometry.parity import closed_shapes, is_inside
from djpt.materials.base import BSDF
from djpt.records import SurfaceInteraction3f
from djpt.types import Color3f, Float, Point3f, UInt32, Vector3f

__all__ = ["AbsorbingMedia"]


class AbsorbingMedia:
    """The absorbing media of a scene. Each has the number of its BSDF; `vacuum` is the number for no medium."""

    def __init__(self, bsdfs: Ensemble[BSDF], geometry: Geometry, bsdf_of_shape: Sequence[int]) -> None:
        self._bsdfs, self._geometry, self._bsdf_of_shape = bsdfs, geometry, bsdf_of_shape
        self.vacuum = len(bsdfs)
        self._absorbing = [i for i, bsdf in enumerate(bsdfs.plugins) if bsdf.absorbs]
        self._members = Members(self._absorbing, len(bsdfs))

    def __bool__(self) -> bool:
        """True if the scene has absorbing media."""
        return bool(self._absorbing)

    def around(self, p: np.ndarray | None) -> int:
        """The medium that a point (3,) lies in, computed at once; None stands for a point outside of all bodies."""
        return self.vacuum if p is None else int(self.at(Point3f(*(float(x) for x in p)))[0])

    def at(self, p: Point3f) -> UInt32:
        """The medium that each point lies in. Traces a ray through the scene per body: only where paths begin."""
        medium = UInt32(self.vacuum)
        closed = closed_shapes(self._geometry)
        for bsdf in self._absorbing:
            shapes = [s for s in closed if self._bsdf_of_shape[s] == bsdf]
            if shapes:
                medium = dr.select(is_inside(self._geometry, p, shapes=shapes), bsdf, medium)
        return medium

    def beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32:
        """The medium of a ray that leaves `si` in the world direction `d`."""
        here = si.bsdf().index
        inside: UInt32 = dr.select(dr.dot(si.sh_frame.n, d) < 0, here, self.vacuum)
        elsewhere = UInt32(self.vacuum) if si.medium is None else si.medium
        return dr.select(self._members.contain(here), inside, elsewhere)

    def transmittance(self, medium: UInt32, distance: Float, lookup: Lookup) -> Color3f:
        """The share of light that is left after a distance in a medium: exp(-sigma distance); 1 in vacuum."""
        # Rays that meet nothing are infinitely long: whatever they are in has no end.
        length = dr.select(distance < dr.inf, distance, 0)
        return self._bsdfs.call(medium, lookup, lambda bsdf: bsdf.transmittance(length), Color3f(1))
