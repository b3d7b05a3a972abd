"""The BSDFs of a scene: which of them a face has."""

from __future__ import annotations

import copy
from collections.abc import Sequence

from djpt.core.records import BSDFFlags, has_flag
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.geometry.aggregate import Geometry
from djpt.jit.types import UInt32
from djpt.materials import BSDF
from djpt.materials.pointer import BSDFPtr

__all__ = ["BSDFs"]

TRANSMITS = BSDFFlags.DiffuseTransmission | BSDFFlags.GlossyTransmission | BSDFFlags.DeltaTransmission


class BSDFs:
    """The BSDFs of a scene by number, and a way to read their values."""

    def __init__(self, bsdfs: Sequence[BSDF], of_shape: Sequence[int], geometry: Geometry, lookup: Lookup) -> None:
        """Number the BSDFs; `of_shape` has the number of each shape's BSDF."""
        self.ensemble: Ensemble[BSDF] = Ensemble(bsdfs)
        self.of_shape = of_shape
        self.lookup = lookup
        self._geometry = geometry
        self._family = Family(self.ensemble, lookup)

    def prepare(self) -> None:
        """Build the tables that kernels read, after the scene was compiled or edited."""
        self._of_face = self._geometry.per_face(self.of_shape)

    def forget(self) -> None:
        """Follow an edit of BSDFs' values: a lobe that it turns on is new code."""
        if not self.ensemble.is_current():
            self.ensemble = Ensemble(self.plugins)
        self._family = Family(self.ensemble, self.lookup)

    def replace(self, lookup: Lookup) -> BSDFs:
        """A view whose values are read through `lookup`."""
        view = copy.copy(self)
        view.lookup, view._family = lookup, Family(self.ensemble, lookup)
        return view

    @property
    def plugins(self) -> Sequence[BSDF]:
        """The BSDFs, each once."""
        return self.ensemble.plugins

    def at(self, face: UInt32) -> BSDFPtr:
        """The BSDFs of faces, per lane."""
        return BSDFPtr.into(self._family, self._of_face.at(face))

    @property
    def refract(self) -> bool:
        """True if a path can cross an interface between different indices of refraction."""
        return any(has_flag(bsdf.flags(), TRANSMITS) for bsdf in self.plugins)

    @property
    def have_null(self) -> bool:
        """True if a path can pass straight through a surface, as if it weren't there."""
        return any(has_flag(bsdf.flags(), BSDFFlags.Null) for bsdf in self.plugins)
