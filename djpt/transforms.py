"""Affine transforms of the scene description, on the host and in double precision."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, ParamSpec

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.numeric import as_array, as_number, as_vector, describe
from djpt.errors import SceneError
from djpt.types import Array3f

__all__ = ["ScalarTransform4f", "Transform4f", "as_transform", "cross_product"]

P = ParamSpec("P")
Matrix = NDArray[np.float64]

FLATTEST = 1e-7
"""A linear part is singular if the smallest singular value of its columns, made unit vectors, is below this.

Kernels compute in float32, in which such a shape can't be represented.
"""

IDENTITY: Matrix = np.eye(4)
IDENTITY.flags.writeable = False


class Chained(Generic[P]):
    """A method that multiplies from the right by what `build` returns.

    Works on the class as well, as in Mitsuba: ``T.translate(v)`` is ``T().translate(v)``.
    """

    def __init__(self, build: Callable[P, Matrix]) -> None:
        self.build = build
        self.__doc__ = build.__doc__

    def __get__(self, instance: ScalarTransform4f | None, owner: type[Any]) -> Callable[P, ScalarTransform4f]:
        def chained(*args: P.args, **kwargs: P.kwargs) -> ScalarTransform4f:
            try:
                right = ScalarTransform4f(self.build(*args, **kwargs))
            except SceneError as error:
                raise SceneError(f"{self.build.__name__}: {error}") from None
            return right if instance is None else instance @ right

        chained.__name__, chained.__doc__ = self.build.__name__, self.__doc__
        return chained


def cross_product(a: Matrix, b: Matrix) -> Matrix:
    """The cross product of two vectors (3,): a tenth of the time that NumPy's takes, which is for many."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def is_far_from_flat(linear: list[list[float]]) -> bool:
    """Whether it is plain from its determinant that a linear map isn't singular; nearly always it is.

    The determinant of unit columns is the product of the singular values, of which none is above the root of 3.
    """
    (a, b, c), (d, e, f), (g, h, i) = linear
    lengths = math.hypot(a, d, g) * math.hypot(b, e, h) * math.hypot(c, f, i)
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return abs(determinant) > 1e-3 * lengths > 0


def matrix_of(value: Any) -> Any:
    """The matrix of a transform (djpt's or Mitsuba's), or `value` itself."""
    # Dr.Jit's arrays have this name as well: they take it for a swizzle.
    return value if dr.is_array_v(value) else getattr(value, "matrix", value)


class ScalarTransform4f:
    """An affine transform, immutable: a 4x4 float64 matrix that acts on column vectors.

    Transforms are composed from the right: ``T().translate(v).rotate(axis, angle)`` rotates
    first. Vectors are three numbers in any form (list, NumPy, Dr.Jit, Mitsuba).

    Args:
        matrix: 4x4 numbers in any form, or another transform; default: the identity.

    Raises:
        SceneError: not a 4x4 matrix, not finite, or the last row isn't (0, 0, 0, 1). The
            methods raise it for arguments that they can't use.
    """

    __slots__ = ("_matrix",)
    __hash__ = None  # type: ignore[assignment]
    # NumPy must leave `array @ transform` to this class, which refuses it.
    __array_ufunc__ = None

    def __init__(self, matrix: Any = None) -> None:
        if matrix is None:
            self._matrix = IDENTITY
            return
        value = as_array(matrix_of(matrix))
        if value.shape != (4, 4):
            raise SceneError(f"must be a 4x4 matrix, found {describe(matrix)} of shape {value.shape}")
        if value[3].tolist() != [0, 0, 0, 1]:
            raise SceneError(f"must be affine: the last row of the matrix is {value[3].tolist()}, not [0, 0, 0, 1]")
        value.flags.writeable = False
        self._matrix = value

    @property
    def matrix(self) -> Matrix:
        """(4, 4) float64, row-major, read-only."""
        return self._matrix

    # ---- building, from the right ----------------------------------------------------

    @Chained
    def translate(v: Any) -> Matrix:
        """Move by `v`."""
        matrix = np.eye(4)
        matrix[:3, 3] = as_vector(v)
        return matrix

    @Chained
    def rotate(axis: Any, angle: Any) -> Matrix:
        """Turn by `angle` degrees about `axis`, counter-clockwise if the axis points at the viewer.

        The axis is normalised (Mitsuba takes it as it is: for unit axes both mean the same).
        """
        direction, radians = as_vector(axis), math.radians(as_number(angle))
        length = np.linalg.norm(direction)
        if length == 0:
            raise SceneError("the axis has length 0")
        x, y, z = direction / length
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # O. Rodrigues: R = I + sin(a) K + (1 - cos(a)) K K
        matrix = np.eye(4)
        matrix[:3, :3] += math.sin(radians) * cross + (1 - math.cos(radians)) * (cross @ cross)
        return matrix

    @Chained
    def scale(v: Any) -> Matrix:
        """Scale by a number, or by one per axis."""
        factors = as_array(v)
        if factors.shape not in ((), (3,)):
            raise SceneError(f"must be one or three numbers, found {describe(v)}")
        return np.diag([*np.broadcast_to(factors, 3), 1.0])

    @Chained
    def look_at(origin: Any, target: Any, up: Any) -> Matrix:
        """Place a camera at `origin` so that it looks along local +z at `target`, with +y near `up`.

        The columns are left = up x direction, the corrected up, direction and origin; so +x points
        to the left of the image.
        """
        eye = as_vector(origin)
        direction = as_vector(target) - eye
        if not direction.any():
            raise SceneError(f"origin and target are the same point {eye.tolist()}")
        direction /= np.linalg.norm(direction)
        left = cross_product(as_vector(up), direction)
        length = np.linalg.norm(left)
        if length <= 1e-9 * np.linalg.norm(as_vector(up)):
            raise SceneError(f"up = {as_vector(up).tolist()} is zero or parallel to the direction of view")
        left /= length
        matrix = np.eye(4)
        matrix[:3] = np.stack([left, cross_product(direction, left), direction, eye], axis=1)
        return matrix

    # ---- applying ----------------------------------------------------------------------

    def __matmul__(self, other: Any) -> Any:
        """Compose with a transform, or apply to points.

        Points are a Dr.Jit 3-array (the result is one, too) or numbers of shape (3,) or (N, 3),
        any number of leading axes (the result is NumPy float64).
        """
        if isinstance(other, ScalarTransform4f):
            return ScalarTransform4f(self._matrix @ other._matrix)
        if matrix_of(other) is not other:
            return ScalarTransform4f(self._matrix @ ScalarTransform4f(other)._matrix)
        return self._apply(other, 1.0)

    def transform_affine(self, p: Any) -> Any:
        """Apply to points, like the operator ``@``."""
        return self._apply(p, 1.0)

    def apply_vector(self, v: Any) -> Any:
        """Apply to vectors, which a translation doesn't change; accepts the same forms as `transform_affine`."""
        return self._apply(v, 0.0)

    def _apply(self, value: Any, w: float) -> Any:
        if dr.is_array_v(value) and dr.is_jit_v(value) and not dr.is_tensor_v(value) and dr.size_v(value) == 3:
            rows = (
                dr.fma(float(a), value.x, dr.fma(float(b), value.y, dr.fma(float(c), value.z, float(d) * w)))
                for a, b, c, d in self._matrix[:3]
            )
            return Array3f(*rows)
        points = as_array(value)
        if points.shape[-1:] != (3,):
            raise SceneError(f"points have three coordinates, found {describe(value)} of shape {points.shape}")
        return points @ self._matrix[:3, :3].T + w * self._matrix[:3, 3]

    # ---- asking ------------------------------------------------------------------------

    def is_singular(self) -> bool:
        """Whether the transform flattens shapes, in the precision of float32."""
        linear = self._matrix[:3, :3]
        if is_far_from_flat(linear.tolist()):
            return False
        lengths = np.linalg.norm(linear, axis=0)
        if not (lengths > 0).all():
            return True
        return bool(np.linalg.svd(linear / lengths, compute_uv=False)[-1] < FLATTEST)

    def inverse(self) -> ScalarTransform4f:
        """The inverse transform; `SceneError` if singular."""
        if self.is_singular():
            raise SceneError("the transform is singular (it flattens shapes) and has no inverse")
        matrix = np.linalg.inv(self._matrix)
        matrix[3] = (0, 0, 0, 1)
        return ScalarTransform4f(matrix)

    def translation(self) -> Matrix:
        """The image of the origin, (3,) float64."""
        return self._matrix[:3, 3].copy()

    @property
    def is_identity(self) -> bool:
        """Whether the transform changes nothing."""
        return self._matrix is IDENTITY or np.array_equal(self._matrix, IDENTITY)

    def has_scale(self) -> bool:
        """Whether the transform changes lengths; mirroring doesn't."""
        lengths = np.linalg.norm(self._matrix[:3, :3], axis=0)
        return bool((np.abs(lengths**2 - 1) > 1e-3).any())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ScalarTransform4f):
            return NotImplemented
        return bool(np.array_equal(self._matrix, other._matrix))

    def __repr__(self) -> str:
        rows = (", ".join(f"{x:.9g}" for x in row) for row in self._matrix)
        return "ScalarTransform4f([" + ",\n                   ".join(f"[{row}]" for row in rows) + "])"


Transform4f = ScalarTransform4f
"""Mitsuba's other name of the class. Transforms are kept on the host, so one class is enough."""


def as_transform(value: Any) -> ScalarTransform4f:
    """Convert any accepted form to an invertible transform.

    Accepted are transforms of djpt and Mitsuba, NumPy arrays, nested lists and Dr.Jit matrices.

    Raises:
        SceneError: not an affine 4x4 matrix, not finite, or singular.
    """
    if value is None:
        raise SceneError("must be a 4x4 matrix, found None")
    transform = value if isinstance(value, ScalarTransform4f) else ScalarTransform4f(value)
    if transform.is_singular():
        raise SceneError(f"must be invertible, found a singular matrix: {transform.matrix.tolist()}")
    return transform
