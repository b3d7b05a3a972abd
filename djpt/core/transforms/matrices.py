"""Matrices of transforms on the host, (3, 3) for the plane and (4, 4) for space, float64."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number, as_vector
from djpt.errors import SceneError

__all__ = [
    "IDENTITIES",
    "Matrix",
    "about_axis",
    "is_far_from_flat",
    "is_unit",
    "rotation",
    "rotation_of_plane",
    "treats_alike",
    "warn_of_length",
]

Matrix = NDArray[np.float64]

ALIKE = 1e-5
"""The largest deviation of a linear part from a rotation with a uniform scale, relative to the scale."""


# ---- identities ------------------------------------------------------------------------


def identity(size: int) -> Matrix:
    """A matrix that changes nothing, read-only."""
    matrix = np.eye(size)
    matrix.flags.writeable = False
    return matrix


IDENTITIES = {size: identity(size) for size in (3, 4)}
"""The matrices that change nothing, by size."""

# ---- rotations -------------------------------------------------------------------------


def rotation(axis: Any, angle: Any, place: str, stacklevel: int) -> Matrix:
    """The 4x4 matrix that turns space by `angle` degrees about `axis`; if that isn't a unit vector, Mitsuba's matrix.

    `place` and `stacklevel` tell the warning about such an axis where it is.

    Raises:
        SceneError: the axis is zero.
    """
    direction, radians = as_vector(axis), math.radians(as_number(angle))
    length = float(np.linalg.norm(direction))
    if length == 0:
        raise SceneError("the axis has length 0")
    unit = is_unit(length)
    if not unit:
        warn_of_length(length, place, stacklevel + 1)
    matrix = np.eye(4)
    if unit:
        matrix[:3, :3] = about_axis(direction / length, radians)
    else:
        # The same for unit axes only: R = cos(a) I + sin(a) K + (1 - cos(a)) x x^T
        sine, cosine = math.sin(radians), math.cos(radians)
        matrix[:3, :3] = (
            cosine * np.eye(3) + sine * cross_matrix(direction) + (1 - cosine) * np.outer(direction, direction)
        )
    return matrix


def about_axis(axis: Matrix, angle: float) -> Matrix:
    """The 3x3 matrix that turns space by `angle` radians about an axis of length 1.

    R = I + sin(a) K + (1 - cos(a)) K K (O. Rodrigues).
    """
    cross = cross_matrix(axis)
    result: Matrix = np.eye(3) + (math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross))
    return result


def cross_matrix(vector: Matrix) -> Matrix:
    """The 3x3 matrix K of the cross product with a vector: K y = x cross y."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def is_unit(length: float) -> bool:
    """True if an axis of this length is a unit vector, in the precision of rounded numbers."""
    return abs(length - 1) < 1e-3


def warn_of_length(length: float, place: str, stacklevel: int) -> None:
    """Warn that the rotation about an axis of this length isn't one."""
    warnings.warn(
        f"{place}: the axis has the length {length:.4g}, so Mitsuba's matrix also scales and shears; "
        "for a rotation give an axis of length 1",
        stacklevel=stacklevel,
    )


def rotation_of_plane(angle: Any) -> Matrix:
    """The 3x3 matrix that turns the plane counter-clockwise by `angle` degrees."""
    radians = math.radians(as_number(angle))
    sine, cosine = math.sin(radians), math.cos(radians)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


# ---- questions -------------------------------------------------------------------------


def treats_alike(matrix: Matrix) -> bool:
    """True if a transform maps points, vectors and the directions of normals alike.

    It must not translate, and turn or mirror with a uniform scale.
    """
    linear, corner = matrix[:-1, :-1], matrix[-1]
    if matrix[:-1, -1].any() or corner[:-1].any() or corner[-1] != 1:
        return False
    squared = linear @ linear.T
    scale = squared.trace() / len(squared)
    return bool((np.abs(squared - scale * np.eye(len(squared))) <= ALIKE * scale).all())


def is_far_from_flat(linear: list[list[float]]) -> bool:
    """True if it is plain from its determinant that a 3x3 matrix isn't singular; nearly always it is.

    The determinant of unit columns is the product of the singular values, of which none is above the root of 3.
    """
    (a, b, c), (d, e, f), (g, h, i) = linear
    lengths = math.hypot(a, d, g) * math.hypot(b, e, h) * math.hypot(c, f, i)
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return abs(determinant) > 1e-3 * lengths > 0
