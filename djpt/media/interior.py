"""Inside absorbing bodies: which one a ray runs through, and how much of its light arrives.

A BSDF that `absorbs` (coloured glass) fills the bodies that it covers. A path remembers the number of the BSDF
whose body it is in: it changes where the path leaves a surface of such a BSDF, to its inside or to its outside,
and nowhere else. So absorbing bodies may hold any other objects, but not touch or hold each other.
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

__all__ = ["Interior"]


class Interior:
    """The absorbing bodies of a scene. Bodies are numbered like the scene's BSDFs; `outside` is none of them."""

    def __init__(self, bsdfs: Ensemble[BSDF], geometry: Geometry, bsdf_of_shape: Sequence[int]) -> None:
        self._bsdfs, self._geometry, self._bsdf_of_shape = bsdfs, geometry, bsdf_of_shape
        self.outside = len(bsdfs)
        self._absorbing = [i for i, bsdf in enumerate(bsdfs.plugins) if bsdf.absorbs]
        self._members = Members(self._absorbing, len(bsdfs))

    @property
    def exists(self) -> bool:
        """Is there any?"""
        return bool(self._absorbing)

    def around(self, p: np.ndarray) -> int:
        """The body that a point (3,) lies in; computed at once, for cameras."""
        return int(self.at(Point3f(*(float(x) for x in p)))[0])

    def at(self, p: Point3f) -> UInt32:
        """The body that each point lies in: takes a ray through the scene, for where paths begin."""
        body = UInt32(self.outside)
        closed = closed_shapes(self._geometry)
        for bsdf in self._absorbing:
            shapes = [s for s in closed if self._bsdf_of_shape[s] == bsdf]
            if shapes:
                body = dr.select(is_inside(self._geometry, p, shapes=shapes), bsdf, body)
        return body

    def beyond(self, si: SurfaceInteraction3f, wo: Vector3f, body: UInt32) -> UInt32:
        """The body of a ray that leaves `si` in the local direction `wo`, having arrived through `body`."""
        here = si.bsdf().index
        inside: UInt32 = dr.select(wo.z < 0, here, self.outside)
        return dr.select(self._members.contain(here), inside, body)

    def transmittance(self, lookup: Lookup, body: UInt32, distance: Float) -> Color3f:
        """What arrives over a distance in `body`; 1 outside."""
        # Rays that meet nothing are infinitely long: whatever they are in has no end.
        length = dr.select(distance < dr.inf, distance, 0)
        return self._bsdfs.call(body, lookup, lambda bsdf: bsdf.transmittance(length), Color3f(1))
