"""The base of transforms: how they are chained, composed and applied; and their matrices on the host, in float64."""

from __future__ import annotations

import copy
import inspect
import math
import warnings
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number, as_vector
from djpt.errors import AmbiguityError, SceneError

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "IDENTITIES",
    "Chained",
    "Matrix",
    "Transform",
    "about_axis",
    "is_far_from_flat",
    "is_unit",
    "matrix_of",
    "rotation",
    "rotation_of_plane",
    "treats_alike",
    "warn_of_length",
]

Matrix = NDArray[np.float64]

ALIKE = 1e-5
"""The largest deviation of a linear part from a rotation with a uniform scale, relative to the scale."""


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
    length = math.sqrt(direction.dot(direction))
    if length == 0:
        raise SceneError("the axis has length 0")
    unit = is_unit(length)
    if not unit:
        warn_of_length(length, place, stacklevel + 1)
    matrix = IDENTITIES[4].copy()
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


# ---- questions about matrices ----------------------------------------------------------------


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


# ---- how transforms are chained, composed and applied ----------------------------------------


class Chained:
    """A method that multiplies from the right by what `build` returns: a transform, or its matrix.

    Works on the class as well, as in Mitsuba: ``T.translate(v)`` is ``T().translate(v)``.
    """

    def __init__(self, build: Callable[..., Any]) -> None:
        self.build = build
        self.__doc__ = build.__doc__

    @cached_property
    def signature(self) -> inspect.Signature:
        """The parameters of the method: those of `build` without the class."""
        _, *parameters = inspect.signature(self.build).parameters.values()
        return inspect.Signature(parameters)

    def __get__(self, instance: Any, owner: type[Any]) -> Callable[..., Any]:
        def chained(*args: Any, **kwargs: Any) -> Any:
            try:
                right = owner._built(self.build(owner, *args, **kwargs))
            except SceneError as error:
                raise SceneError(f"{self.build.__name__}: {error}") from None
            return right if instance is None else instance @ right

        chained.__name__, chained.__doc__ = self.build.__name__, self.__doc__
        chained.__signature__ = self.signature  # type: ignore[attr-defined]
        return chained


def matrix_of(value: Any) -> Any:
    """The matrix of a transform (djpt's or Mitsuba's), or `value` itself."""
    # Dr.Jit's arrays have this name as well: they take it for a swizzle.
    return value if dr.is_array_v(value) else getattr(value, "matrix", value)


class Transform:
    """A map of points, vectors, normals and rays by a matrix that acts on homogeneous column vectors.

    Points, vectors and normals are one type of Dr.Jit array here, so ``T @ array`` can't tell them apart. It
    works where T treats them alike: where it doesn't translate and keeps all angles. Elsewhere it raises
    `AmbiguityError`, and `transform_point`, `transform_vector` or `transform_normal` say what is meant.
    Lists, tuples and NumPy arrays are points, as in Mitsuba.
    """

    __slots__ = ()

    size: ClassVar[int]
    """Rows of the matrix: 4 for maps of space, 3 for maps of the plane."""
    projective: ClassVar[bool] = False
    """True if the last row of the matrix may be any; else it is (0, .., 0, 1)."""
    on_lanes: ClassVar[bool] = False
    """True if the entries are Dr.Jit arrays."""

    # NumPy must leave `array @ transform` to this class, which refuses it.
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    matrix: Any
    inverse_transpose: Any

    def __init__(self, matrix: Any = None, inverse_transpose: Any = None) -> None:
        raise NotImplementedError

    @classmethod
    def _built(cls, value: Any) -> Self:
        """The transform of what one of the builders has made."""
        return cls(value)

    # ---- composing ---------------------------------------------------------------------

    def __matmul__(self, other: Any) -> Any:
        """Compose with a transform (which is applied first), or apply to points or a ray."""
        if type(other) is type(self):
            return self._product(self, other)
        if isinstance(other, Transform):
            kind = self._kind_of_product(other)
            return kind._product(kind._of(self), kind._of(other))
        if hasattr(other, "o") and hasattr(other, "d") and not dr.is_array_v(other):
            return self._transform_ray(other)
        if dr.is_array_v(other) and not dr.is_tensor_v(other):
            if not self._treats_alike():
                raise AmbiguityError(
                    f"T @ x: this {type(self).__name__} treats points, vectors and normals differently, and a Dr.Jit "
                    "array doesn't say which of them it holds; write T.transform_point(x), T.transform_vector(x) or "
                    "T.transform_normal(x)"
                )
            return self.transform_point(other)
        if isinstance(other, (str, bytes, dict, set)) or not hasattr(other, "__len__"):
            return self._matmul_other(other)
        return self.transform_point(other)

    def _matmul_other(self, other: Any) -> Any:
        """Apply to, or compose with, what isn't a transform, a ray, an array or a sequence."""
        return NotImplemented

    def __mul__(self, other: Any) -> Any:
        raise SceneError(f"{type(self).__name__} * x: transforms are composed and applied with the operator @")

    def _kind_of_product(self, other: Transform) -> type[Transform]:
        """The class of ``self @ other``: on lanes if one factor is, and projective if one is."""
        for kind in (type(self), type(other)):
            on_lanes = kind.on_lanes or not (self.on_lanes or other.on_lanes)
            projective = kind.projective or not (self.projective or other.projective)
            if on_lanes and projective and self.size == other.size:
                return kind
        raise SceneError(
            f"{type(self).__name__} @ {type(other).__name__}: the two can't be composed; convert one of them to a kind "
            "that can hold both, such as ProjectiveTransform4f(T)"
        )

    @classmethod
    def _of(cls, transform: Transform) -> Self:
        """`transform` as one of this class."""
        return transform if type(transform) is cls else cls(transform)

    @classmethod
    def _product(cls, left: Self, right: Self) -> Self:
        raise NotImplementedError

    # ---- applying ----------------------------------------------------------------------

    def _treats_alike(self) -> bool:
        """True if points, vectors and the directions of normals are known to be mapped alike."""
        raise NotImplementedError

    def transform_point(self, p: Any) -> Any:
        """Apply to points."""
        raise NotImplementedError

    def transform_vector(self, v: Any) -> Any:
        """Apply to vectors, which a translation doesn't change."""
        raise NotImplementedError

    def transform_normal(self, n: Any) -> Any:
        """Apply to normals: by the inverse transpose, so that they stay perpendicular. Their length changes."""
        raise NotImplementedError

    def apply_vector(self, v: Any) -> Any:
        """Map a vector: another name of `transform_vector`."""
        return self.transform_vector(v)

    def transform_affine(self, p: Any = None, *, v: Any = None, n: Any = None, ray: Any = None) -> Any:
        """Apply the transform, as the operator ``@`` does; by name, `v` are vectors and `n` normals."""
        given = [x for x in (p, v, n, ray) if x is not None]
        if len(given) != 1:
            raise SceneError(f"transform_affine: takes one of p, v, n and ray, found {len(given)}")
        if v is not None:
            return self.transform_vector(v)
        return self @ given[0] if n is None else self.transform_normal(n)

    def _transform_ray(self, ray: Any) -> Any:
        """`ray` with origin and direction transformed, and those of its differentials, if it has some."""
        moved = copy.copy(ray)
        for name in ("o", "o_x", "o_y"):
            if hasattr(ray, name):
                setattr(moved, name, self.transform_point(getattr(ray, name)))
        for name in ("d", "d_x", "d_y"):
            if hasattr(ray, name):
                setattr(moved, name, self.transform_vector(getattr(ray, name)))
        return moved
