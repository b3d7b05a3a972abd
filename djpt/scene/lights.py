"""The BSDFs and lights of a scene, and which of them each face has."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import drjit as dr
import numpy as np

from djpt.core.lookup import Members
from djpt.core.records import BSDFFlags, EmitterFlags, has_flag
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.emitters import Emitter
from djpt.emitters.light_samplers import make_light_sampler
from djpt.emitters.light_samplers.sampling import LightSampler, LightSampling
from djpt.emitters.pointer import EmitterPtr
from djpt.geometry.aggregate import Geometry
from djpt.jit.types import Bool, UInt32
from djpt.materials import BSDF
from djpt.materials.pointer import BSDFPtr

__all__ = ["BSDFs", "Lights"]

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
    def reflect_lights(self) -> bool:
        """True unless all are known to be perfectly specular, so that light sampling never finds light."""
        return not all(bsdf.flags() and not has_flag(bsdf.flags(), BSDFFlags.Smooth) for bsdf in self.plugins)

    @property
    def have_null(self) -> bool:
        """True if some surfaces let paths pass straight through (null lobes)."""
        return any(has_flag(bsdf.flags(), BSDFFlags.Null) for bsdf in self.plugins)


class Lights:
    """The emitters of a scene by number, a way to choose among them, and a way to read their values.

    Emitters have the numbers of `Scene.emitters`; their count stands for none.
    """

    def __init__(
        self, emitters: Sequence[Emitter], of_shape: Sequence[int], geometry: Geometry, lookup: Lookup
    ) -> None:
        """Number the emitters; `of_shape` has the number of each shape's emitter."""
        self.ensemble: Ensemble[Emitter] = Ensemble(emitters)
        self.lookup = lookup
        self._geometry, self._of_shape = geometry, of_shape
        self._from_infinity = [i for i, emitter in enumerate(emitters) if emitter.from_infinity]
        self._at_infinity = Members(self._from_infinity, len(emitters))
        infinite = [i for i, emitter in enumerate(emitters) if emitter.is_environment()]
        self._on_miss = infinite[0] if infinite else len(emitters)
        self._choice = "uniform"
        # Views share what was made once.
        self._light_samplers: dict[str, LightSampler] = {}
        self._brightness: list[float] = []
        self.forget()

    def prepare(self) -> None:
        """Build the tables that kernels read, after the scene was compiled or edited."""
        self._of_face = self._geometry.per_face(self._of_shape)

    def forget(self) -> None:
        """Follow an edit of emitters' values."""
        if not self.ensemble.is_current():
            self.ensemble = Ensemble(self.ensemble.plugins)
        self._family = Family(self.ensemble, self.lookup)

    def forget_choices(self) -> None:
        """Follow an edit that may change how bright the emitters are."""
        # A uniform choice depends on no value. Made anew now and then, it would be news to `dr.freeze` each time.
        for name in set(self._light_samplers) - {"uniform"}:
            del self._light_samplers[name]
        self._brightness.clear()

    def replace(self, lookup: Lookup | None = None, choice: str | None = None) -> Lights:
        """A view whose values are read through `lookup`, or whose emitters are chosen in another way.

        See `djpt.emitters.light_samplers` for the ways to choose. It is the object itself if nothing changes.
        """
        if lookup is None and choice in (None, self._choice):
            return self
        view = copy.copy(self)
        view.lookup = self.lookup if lookup is None else lookup
        view._choice = self._choice if choice is None else choice
        view._family = Family(view.ensemble, view.lookup)
        return view

    # ---- choice ---------------------------------------------------------------------------

    @property
    def choice(self) -> LightSampler:
        """The way to choose an emitter, made when it is first needed."""
        name = self._choice
        if name not in self._light_samplers:
            self._light_samplers[name] = make_light_sampler(name, self.ensemble.plugins)
        return self._light_samplers[name]

    @property
    def sampling(self) -> LightSampling:
        """Sampling of directions towards the emitters."""
        return LightSampling(self.ensemble, self.choice, self.lookup)

    @property
    def brightness(self) -> float:
        """A rough estimate of the radiance in the scene, as a power of two.

        It is that of the power of all emitters, spread over a sphere about the scene.
        """
        if not self._brightness:
            low, high = self._geometry.bounding_box()
            radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6)
            radiance = sum(e.power() for e in self.ensemble.plugins) / (math.pi * 4 * math.pi * radius**2)
            self._brightness.append(2.0 ** round(math.log2(radiance)) if radiance > 0 else 1.0)
        return self._brightness[0]

    # ---- emitters by number ------------------------------------------------------------------

    @property
    def environment(self) -> Emitter | None:
        """The emitter that surrounds the scene, or None."""
        return self.ensemble.plugins[self._on_miss] if self._on_miss < len(self.ensemble) else None

    @property
    def can_be_met(self) -> bool:
        """Whether rays can hit emitters: false if all are point lights or parallel light."""
        delta = EmitterFlags.DeltaPosition | EmitterFlags.DeltaDirection
        return any(not has_flag(emitter.flags(), delta) for emitter in self.ensemble.plugins)

    def index_at(self, face: UInt32, hit: Bool) -> UInt32:
        """The number of the emitter that a ray meets: that of the face or, where it isn't a `hit`, the environment."""
        return dr.select(hit, self._of_face.at(face), UInt32(self._on_miss))

    def at(self, index: UInt32) -> EmitterPtr:
        """The emitters with the numbers `index`, per lane."""
        return EmitterPtr.into(self._family, index)

    def from_infinity(self, index: UInt32) -> Bool | None:
        """True where an emitter is infinitely far away; None if none is."""
        return self._at_infinity.contain(index) if self._from_infinity else None
