"""The silhouettes of a scene's shapes, and the choice among them."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import DiscontinuityFlags
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import Family
from djpt.distributions.discrete import Weights
from djpt.jit.types import Bool, Float, Point3f, UInt32
from djpt.shapes import Shape
from djpt.shapes.pointer import ShapePtr

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["Silhouettes"]

PERIMETER, INTERIOR = int(DiscontinuityFlags.PerimeterType), int(DiscontinuityFlags.InteriorType)


class Silhouettes:
    """The silhouettes of all shapes that are differentiated, chosen by the shapes' weights."""

    def __init__(self, shapes: Sequence[Shape], lookup: Lookup) -> None:
        """`shapes`: all shapes of the scene; `lookup` reads their values."""
        self._every_shape, self.lookup = shapes, lookup
        self._followed: tuple[Shape, ...] | None = None
        self.forget()

    def forget(self) -> None:
        """Follow an edit of shapes."""
        self._chosen_among: dict[tuple[int, ...], tuple[Family[Any], Weights]] = {}

    def following(self, shapes: Sequence[Shape]) -> Silhouettes:
        """A view that has the silhouettes of given shapes, whether these are differentiated or not."""
        view = copy.copy(self)
        view._followed = tuple(shapes)
        view.forget()
        return view

    def replace(self, lookup: Lookup) -> Silhouettes:
        """A view whose values are read through `lookup`."""
        view = copy.copy(self)
        view.lookup = lookup
        view.forget()
        return view

    def shapes(self) -> list[Any]:
        """The shapes that have silhouettes: those with gradients and a `silhouette_sampling_weight` above 0."""
        if self._followed is not None:
            return list(self._followed)
        return [
            shape
            for shape in self._every_shape
            if shape.parameters_grad_enabled()
            and shape.silhouette_sampling_weight() > 0
            and shape.silhouette_discontinuity_types()
        ]

    def outlined(self) -> list[Any]:
        """All shapes whose silhouettes are known, those that stay, too."""
        return [
            shape
            for shape in self._every_shape
            if shape.silhouette_discontinuity_types() and shape.silhouette_sampling_weight() > 0
        ]

    def shape(self, number: UInt32) -> ShapePtr:
        """The shapes that `SilhouetteSample3f.scene_index` counts, per lane."""
        found = self._choice()
        pointer: ShapePtr = ShapePtr() if found is None else ShapePtr.into(found[0], number)
        return pointer

    def _choice(self) -> tuple[Family[Any], Weights] | None:
        """The shapes with silhouettes, and how they are chosen; None if there are none."""
        shapes = self.shapes()
        if not shapes:
            return None
        key = tuple(id(shape) for shape in shapes)
        if key not in self._chosen_among:
            weights = Weights(Float([shape.silhouette_sampling_weight() for shape in shapes]))
            self._chosen_among[key] = Family(Ensemble(shapes), self.lookup), weights
        return self._chosen_among[key]

    def sample(self, sample: Point3f, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette that belongs to a point of the unit cube: see `Scene.sample_silhouette`."""
        from djpt.shapes.silhouettes.samples import SilhouetteSample3f  # rendering needs no silhouettes

        empty = SilhouetteSample3f()
        found = self._choice()
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

    def invert(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample` takes to a segment; `ss.scene_index` tells the shape."""
        found = self._choice()
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
