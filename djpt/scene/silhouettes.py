"""What scripts ask a scene about the silhouettes of its shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import DiscontinuityFlags
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.distributions.weights import Weights
from djpt.jit.types import Bool, Float, Point3f, UInt32, converting
from djpt.shapes.pointer import ShapePtr

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["SceneSilhouettes"]

PERIMETER, INTERIOR = int(DiscontinuityFlags.PerimeterType), int(DiscontinuityFlags.InteriorType)


class SceneSilhouettes:
    """The part of a scene that chooses among the silhouettes of all shapes that are differentiated."""

    lookup: Lookup
    _shapes: list[Any]
    _families: dict[Any, Any]

    def silhouette_shapes(self) -> list[Any]:
        """The shapes that have silhouettes: those with gradients and a `silhouette_sampling_weight` above 0."""
        return [
            shape
            for shape in self._shapes
            if shape.parameters_grad_enabled()
            and shape.silhouette_sampling_weight() > 0
            and shape.silhouette_discontinuity_types()
        ]

    def silhouette_shape(self, number: UInt32) -> ShapePtr:
        """The shapes that `SilhouetteSample3f.scene_index` counts, per lane."""
        found = self._silhouettes()
        pointer: ShapePtr = ShapePtr() if found is None else ShapePtr.into(found[0], number)
        return pointer

    def shapes_grad_enabled(self) -> bool:
        """Whether a parameter that places a shape has gradients."""
        return any(shape.parameters_grad_enabled() for shape in self._shapes)

    def _silhouettes(self) -> tuple[Family[Any], Weights] | None:
        """The shapes with silhouettes, and how they are chosen; None if there are none."""
        shapes = self.silhouette_shapes()
        if not shapes:
            return None
        key = ("silhouettes", *(id(shape) for shape in shapes))
        if key not in self._families:
            weights = Weights(Float([shape.silhouette_sampling_weight() for shape in shapes]))
            self._families[key] = (Family(Ensemble(shapes), self.lookup), weights)
        found: tuple[Family[Any], Weights] = self._families[key]
        return found

    @converting
    def sample_silhouette(self, sample: Point3f, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette of any shape that belongs to a point of the unit cube.

        Shapes are chosen by their weights. If `flags` names both kinds of silhouettes, a shape that has both shows each
        with probability 1/2, and a shape that has one shows it.
        """
        from djpt.shapes.silhouettes.samples import SilhouetteSample3f  # rendering needs no silhouettes

        empty = SilhouetteSample3f()
        found = self._silhouettes()
        if found is None:
            return empty
        family, weights = found
        number, x, chance = weights.choose(sample.x, active)
        shape, flags = ShapePtr.into(family, number), int(flags)
        if bool(flags & PERIMETER) != bool(flags & INTERIOR):
            ss = shape.sample_silhouette(Point3f(x, sample.y, sample.z), flags, active)
        else:
            types = shape.silhouette_discontinuity_types()
            both = types == PERIMETER | INTERIOR
            interior = (types == INTERIOR) | (both & (x < 0.5))
            x = dr.select(both, 2 * x - dr.select(interior, Float(0), 1), x)
            others = flags & ~(PERIMETER | INTERIOR)
            point = Point3f(x, sample.y, sample.z)
            ss = dr.select(
                interior,
                shape.sample_silhouette(point, INTERIOR | others, active & interior),
                shape.sample_silhouette(point, PERIMETER | others, active & ~interior),
            )
            ss.pdf = dr.select(both, 0.5 * ss.pdf, ss.pdf)
            # All that were asked for, so that the sample can be inverted.
            ss.flags = dr.select(ss.is_valid(), UInt32(flags), 0)
        ss.pdf = ss.pdf * chance
        ss.scene_index = number
        failed = dr.isnan(dr.sum(ss.p) + dr.sum(ss.d) + dr.sum(ss.n))
        return dr.select(failed, empty, ss)

    def invert_silhouette_sample(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample_silhouette` takes to a segment; `ss.scene_index` tells the shape."""
        found = self._silhouettes()
        if found is None:
            return Point3f(0)
        family, weights = found
        shape = ShapePtr.into(family, ss.scene_index)
        point = shape.invert_silhouette_sample(ss, active)
        both = shape.silhouette_discontinuity_types() == PERIMETER | INTERIOR
        asked_for_both = (ss.flags & (PERIMETER | INTERIOR)) == PERIMETER | INTERIOR
        half = 0.5 * point.x + dr.select(ss.discontinuity_type == INTERIOR, Float(0), 0.5)
        x = dr.select(both & asked_for_both, half, point.x)
        begin, chance = weights.probability_below(ss.scene_index, active), weights.probability(ss.scene_index, active)
        return Point3f(dr.fma(x, chance, begin), point.y, point.z)
