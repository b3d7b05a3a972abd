"""What only scripts ask of pointers to shapes about silhouettes, and about how the shapes move."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.dispatch.family import Pointer
from djpt.dispatch.lookup import choose
from djpt.records import SurfaceInteraction3f
from djpt.shapes.base import Shape
from djpt.types import Bool, Float, Point3f, UInt32

if TYPE_CHECKING:
    from djpt.silhouettes.samples import SilhouetteSample3f

__all__ = ["SilhouettePtrQuestions"]


class SilhouettePtrQuestions(Pointer[Shape]):
    """The part of `djpt.ShapePtr` that projective sampling asks."""

    def silhouette_discontinuity_types(self) -> UInt32:
        """The `DiscontinuityFlags` of the silhouettes per lane; 0 where there is no shape."""
        return dr.select(self.is_valid(), self.number(lambda shape: shape.silhouette_discontinuity_types()), 0)

    def silhouette_sampling_weight(self) -> Float:
        """The weights by which a scene chooses shapes to sample silhouettes of; 0 where there is no shape."""
        weights = [Float(shape.silhouette_sampling_weight()) for shape in self.plugins]
        return dr.select(self.is_valid(), choose(self.index, weights), 0) if weights else Float(0)

    def sample_silhouette(self, sample: Any, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette that belongs to a point of the unit cube: see `djpt.Shape.sample_silhouette`."""
        point = Point3f(sample)
        return self._silhouettes(lambda silhouette: silhouette.sample(point, int(flags), active))

    def invert_silhouette_sample(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample_silhouette` takes to a segment; 0 where there is no shape."""
        return self._ask_silhouettes(lambda silhouette: silhouette.invert(ss, active), Point3f(0))

    def primitive_silhouette_projection(
        self, viewpoint: Any, si: SurfaceInteraction3f, flags: int, sample: Any, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of the silhouette as seen from a point: see `djpt.Shape.primitive_silhouette_projection`."""
        seen_from, u = Point3f(viewpoint), Float(sample)
        return self._silhouettes(lambda silhouette: silhouette.project(seen_from, si, int(flags), u, active))

    def sample_precomputed_silhouette(
        self, viewpoint: Any, sample1: Any, sample2: Any, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of a part of the silhouette: see `djpt.Shape.sample_precomputed_silhouette`."""
        seen_from, part, u = Point3f(viewpoint), UInt32(sample1), Float(sample2)
        return self._silhouettes(lambda silhouette: silhouette.sample_precomputed(seen_from, part, u, active))

    def differential_motion(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Point3f:
        """The point `si.p`, attached to the parameters of the shapes: see `djpt.Shape.differential_motion`."""
        p = Point3f(si.p)
        for number, shape in enumerate(self.plugins):
            if shape.parameters_grad_enabled():
                p = dr.select(self.index == number, shape.differential_motion(si, active), p)
        return p

    def _silhouettes(self, question: Callable[[Any], SilhouetteSample3f]) -> SilhouetteSample3f:
        nothing = importlib.import_module("djpt.silhouettes.samples").SilhouetteSample3f()
        found: SilhouetteSample3f = self._ask_silhouettes(question, nothing)
        return importlib.import_module("djpt.silhouettes.pointers").numbered(found, self.plugins, self.index)

    def _ask_silhouettes(self, question: Callable[[Any], Any], otherwise: Any) -> Any:
        ask = importlib.import_module("djpt.silhouettes.pointers").ask
        return ask(self.ensemble, self.index, self.lookup, question, otherwise)
