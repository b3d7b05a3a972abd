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

import math
from collections.abc import Sequence

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.jit.kernels import as_float
from djpt.jit.types import Float, Vector3f

__all__ = ["ALIGNED", "Axis", "AxisPool", "ProjectedRay", "SignedAxis"]

ALIGNED = 2e-7
"""Unit directions closer than this are one axis, and smaller components are 0: float32 can't tell them apart."""


class Axis:
    """A unit direction, up to its sign.

    Coordinate axes are known at trace time, and so are single components that are 0: those of upright boxes, turned
    about the vertical. Not so if the axis is `movable`: one that came into being by an edit stays a value even if it
    happens to be aligned, so that the next edit compiles nothing.
    """

    def __init__(self, direction: NDArray[np.float64], movable: bool = False) -> None:
        self.users = 0
        self.zeros = () if movable else tuple(k for k in range(3) if abs(direction[k]) < ALIGNED)
        """The components that are known to be 0."""
        self.assign(direction)
        unit = np.eye(3)[int(np.argmax(np.abs(direction)))]
        aligned = not movable and np.abs(direction - unit).max() < ALIGNED
        self.coordinate = int(np.argmax(unit)) if aligned else None
        if aligned:
            self.vector = Vector3f(*(float(x) for x in unit))

    def assign(self, direction: NDArray[np.float64]) -> None:
        """Take a new direction that fits; only for axes of a single shape, whose kernels read `vector` as a value."""
        self.direction = direction
        self.vector = Vector3f(*(Float(0) if k in self.zeros else as_float(direction[k]) for k in range(3)))

    def fits(self, direction: NDArray[np.float64]) -> bool:
        """Whether the axis can take a new direction without a change of structure."""
        return self.coordinate is None and all(abs(direction[k]) < ALIGNED for k in self.zeros)

    def dot(self, v: Vector3f) -> Float:
        """The component of `v` along the axis."""
        if self.coordinate is not None:
            return v[self.coordinate]
        if not self.zeros:
            return dr.dot(self.vector, v)
        i, j = (k for k in range(3) if k not in self.zeros)
        return dr.fma(self.vector[j], v[j], self.vector[i] * v[i])


class SignedAxis:
    """An axis together with the sense in which a shape uses it."""

    def __init__(self, axis: Axis, negative: bool) -> None:
        self.axis = axis
        self.negative = negative

    def key(self) -> tuple[int, bool]:
        """Equal for the same axis and sense."""
        return (id(self.axis), self.negative)


def canonical(direction: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """The direction scaled to unit length with its largest component positive, and whether that was negative."""
    unit = direction / np.linalg.norm(direction)
    negative = bool(unit[int(np.argmax(np.abs(unit)))] < 0)
    return (-unit if negative else unit), negative


class AxisPool:
    """All axes of a scene's plane-bounded shapes."""

    def __init__(self) -> None:
        self.axes: list[Axis] = []

    def find(
        self, directions: Sequence[NDArray[np.float64]], previous: Sequence[SignedAxis] | None = None
    ) -> tuple[SignedAxis, ...]:
        """The axes for a shape's directions.

        Without `previous`, or if those belong to another pool (the shape is a copy of another, or was
        part of another scene), existing axes of those directions or new ones. With `previous` (the shape
        was edited), the same axes where they still fit or can move along, else axes of its own.
        """
        if previous is None or any(signed.axis not in self.axes for signed in previous):
            return tuple(self._join(direction) for direction in directions)
        self._move_private(directions, previous)
        kept = [self._keep(d, p) for d, p in zip(directions, previous, strict=True)]
        if all(signed is not None for signed in kept):
            return tuple(signed for signed in kept if signed is not None)
        # An alignment has ended. The shape leaves all its axes at once, so that this happens once.
        for signed in previous:
            signed.axis.users -= 1
        own = AxisPool()
        result = tuple(own._join(d, movable=True) for d in directions)
        self.axes.extend(own.axes)
        return result

    def _join(self, direction: NDArray[np.float64], movable: bool = False) -> SignedAxis:
        unit, negative = canonical(direction)
        for axis in self.axes:
            if np.abs(axis.direction - unit).max() < ALIGNED:
                break
        else:
            axis = Axis(unit, movable)
            self.axes.append(axis)
        axis.users += 1
        return SignedAxis(axis, negative)

    def _move_private(self, directions: Sequence[NDArray[np.float64]], previous: Sequence[SignedAxis]) -> None:
        """Turn the axes that only this shape uses, where all its uses agree on the new direction."""
        for axis in {id(signed.axis): signed.axis for signed in previous}.values():
            wanted = [
                d / np.linalg.norm(d) * (-1 if signed.negative else 1)
                for d, signed in zip(directions, previous, strict=True)
                if signed.axis is axis
            ]
            agree = all(np.abs(w - wanted[0]).max() < ALIGNED for w in wanted)
            if axis.users == len(wanted) and agree and axis.fits(wanted[0]):
                axis.assign(wanted[0])

    def _keep(self, direction: NDArray[np.float64], previous: SignedAxis) -> SignedAxis | None:
        """The previous axis if it still has the direction, in either sense; else None."""
        sense = -1 if previous.negative else 1
        unit = direction / np.linalg.norm(direction) * sense
        if np.abs(previous.axis.direction - unit).max() < ALIGNED:
            return previous
        if np.abs(previous.axis.direction + unit).max() < ALIGNED:
            return SignedAxis(previous.axis, not previous.negative)
        return None


class ProjectedRay:
    """A ray with its projections onto axes, each computed once."""

    def __init__(self, ray: Ray3f) -> None:
        self.ray = ray
        maxt = ray.maxt
        self.unbounded = maxt.state == dr.VarState.Literal and maxt[0] == math.inf
        """Whether it is known, while the kernel is traced, that the ray has no end."""
        self._projections: dict[int, tuple[Float, Float, Float]] = {}

    def onto(self, axis: Axis) -> tuple[Float, Float, Float]:
        """(o.a, d.a, 1 / d.a); the last is infinite for rays across the axis."""
        key = id(axis)
        if key not in self._projections:
            d = axis.dot(self.ray.d)
            self._projections[key] = (axis.dot(self.ray.o), d, dr.rcp(d))
        return self._projections[key]
