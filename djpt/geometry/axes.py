"""Axes that several plane-bounded shapes share, and rays projected onto them.

Walls, floors and boxes are intersected as slabs: pairs of planes along an axis. In real
scenes many of them share their axes (most often x, y and z), and a ray's projection onto an
axis (two dot products and one division) is then needed once for all. Which shape uses which
axis is *structure*, part of the compiled kernel. An edit keeps the structure if it can: an
axis that no other shape uses just changes its value. Only an edit that ends an alignment (a
wall rotated out of the plane that it shared) gives the shape an axis of its own, and the
next render compiles a kernel for the new structure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import drjit as dr

from djpt.lookup import as_float
from djpt.records import Ray3f
from djpt.types import Float, Vector3f

__all__ = ["Axis", "AxisPool", "ProjectedRay", "SignedAxis"]

ALIGNED = 2e-7
"""Unit directions closer than this are one axis: float32 can't tell them apart."""


class Axis:
    """A unit direction, up to its sign. Coordinate axes are known at trace time."""

    def __init__(self, direction: NDArray[np.float64]) -> None:
        self.users = 0
        self.assign(direction)
        unit = np.eye(3)[int(np.argmax(np.abs(direction)))]
        self.coordinate = int(np.argmax(unit)) if np.abs(direction - unit).max() < ALIGNED else None
        if self.coordinate is not None:
            self.vector = Vector3f(*(float(x) for x in unit))

    def assign(self, direction: NDArray[np.float64]) -> None:
        """Take a new direction; for axes with one user, whose kernels read `vector` as a value."""
        self.direction = direction
        self.vector = Vector3f(*(as_float(x) for x in direction))

    @property
    def movable(self) -> bool:
        """Can the direction change without changing the structure?"""
        return self.coordinate is None and self.users == 1

    def dot(self, v: Vector3f) -> Float:
        """The component of `v` along the axis."""
        return dr.dot(self.vector, v) if self.coordinate is None else v[self.coordinate]


class SignedAxis:
    """An axis together with the sense in which a shape uses it."""

    def __init__(self, axis: Axis, negative: bool) -> None:
        self.axis = axis
        self.negative = negative

    def key(self) -> tuple[int, bool]:
        """Equal for the same axis and sense."""
        return (id(self.axis), self.negative)


def canonical(direction: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """The direction scaled to unit length with its largest component positive; was it negative?"""
    unit = direction / np.linalg.norm(direction)
    negative = bool(unit[int(np.argmax(np.abs(unit)))] < 0)
    return (-unit if negative else unit), negative


class AxisPool:
    """All axes of a scene's plane-bounded shapes."""

    def __init__(self) -> None:
        self.axes: list[Axis] = []

    def find(self, direction: NDArray[np.float64], previous: SignedAxis | None = None) -> SignedAxis:
        """The axis for a shape's direction.

        Without `previous`, an existing axis of that direction or a new one. With `previous`
        (the shape was edited), the same axis if it still fits or can move, else one of its own.
        """
        unit, negative = canonical(direction)
        if previous is None:
            for axis in self.axes:
                if np.abs(axis.direction - unit).max() < ALIGNED:
                    axis.users += 1
                    return SignedAxis(axis, negative)
        else:
            axis = previous.axis
            if np.abs(axis.direction - unit).max() < ALIGNED:
                return SignedAxis(axis, negative)
            if axis.movable:
                # Keep the old sense if possible: flipping the vector is a value, the sense is structure.
                if negative != previous.negative:
                    unit, negative = -unit, previous.negative
                axis.assign(unit)
                return SignedAxis(axis, negative)
            axis.users -= 1
        axis = Axis(unit)
        if previous is not None and axis.coordinate is not None:
            # An axis that came into being by an edit stays a value: the next edit must not recompile.
            axis.coordinate = None
            axis.assign(unit)
        axis.users = 1
        self.axes.append(axis)
        return SignedAxis(axis, negative)


class ProjectedRay:
    """A ray with its projections onto axes, each computed once."""

    def __init__(self, ray: Ray3f) -> None:
        self.ray = ray
        self._projections: dict[int, tuple[Float, Float, Float]] = {}

    def onto(self, axis: Axis) -> tuple[Float, Float, Float]:
        """(o.a, d.a, 1 / d.a); the last is infinite for rays across the axis."""
        key = id(axis)
        if key not in self._projections:
            d = axis.dot(self.ray.d)
            self._projections[key] = (axis.dot(self.ray.o), d, dr.rcp(d))
        return self._projections[key]
