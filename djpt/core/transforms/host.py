"""Transforms of the scene description, on the host and in double precision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import drjit.scalar as scalar
import numpy as np

from djpt.core.numeric import as_array, as_number, as_vector, cross_product, describe, is_finite
from djpt.core.transforms.base import (
    IDENTITIES,
    Chained,
    Matrix,
    Transform,
    is_far_from_flat,
    matrix_of,
    rotation,
    rotation_of_plane,
    treats_alike,
)
from djpt.errors import SceneError

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "HostTransform",
    "ScalarTransform3f",
    "ScalarTransform4f",
    "SpatialHostTransform",
    "as_transform",
]


FLATTEST = 1e-7
"""A linear part is singular if the smallest singular value of its columns, made unit vectors, is below this.

Kernels compute in float32, in which such a shape can't be represented.
"""


class HostTransform(Transform):
    """A transform of float64 numbers; nothing but `assign` changes it.

    The inverse is always computed; an `inverse_transpose` that is given has to agree.
    """

    __slots__ = ("_matrix",)

    def __init__(self, matrix: Any = None, inverse_transpose: Any = None) -> None:
        n = self.size
        if matrix is None:
            self._matrix = IDENTITIES[n]
            return
        value = as_array(matrix_of(matrix))
        if value.shape != (n, n):
            raise SceneError(f"must be a {n}x{n} matrix, found {describe(matrix)} of shape {value.shape}")
        last = [0] * (n - 1) + [1]
        if not self.projective and value[-1].tolist() != last:
            raise SceneError(f"must be affine: the last row of the matrix is {value[-1].tolist()}, not {last}")
        value.flags.writeable = False
        self._matrix = value
        if inverse_transpose is not None and not np.allclose(
            as_array(inverse_transpose).T @ value, np.eye(n), atol=1e-3
        ):
            raise SceneError("inverse_transpose isn't the transposed inverse of the matrix")

    @classmethod
    def _built(cls, value: Any) -> Self:
        # A new matrix, whose form is right: that of a product, too.
        if type(value) is not np.ndarray:
            return cls(value)
        if not is_finite(value):
            raise SceneError(f"must be finite in single precision, found {describe(value)}")
        result = cls.__new__(cls)
        value.flags.writeable = False
        result._matrix = value
        return result

    @property
    def matrix(self) -> Matrix:
        """(size, size) float64, row-major, read-only."""
        return self._matrix

    @property
    def inverse_transpose(self) -> Matrix:
        """The transposed inverse of the matrix, float64; `SceneError` if singular."""
        return self.inverse()._matrix.T

    def assign(self, other: Any) -> None:
        """Become equal to another transform of the same size; plugins keep copies, which stay as they are."""
        self._matrix = type(self)(other)._matrix

    # ---- building, from the right ----------------------------------------------------

    @Chained
    def translate(kind: Any, v: Any) -> Matrix:
        """Move by `v`, one number per axis or one for all."""
        matrix: Matrix = IDENTITIES[kind.size].copy()
        matrix[:-1, -1] = kind._per_axis(v)
        return matrix

    @Chained
    def scale(kind: Any, v: Any) -> Matrix:
        """Scale by a number, or by one per axis."""
        return np.diag([*kind._per_axis(v), 1.0])

    @classmethod
    def _per_axis(cls, v: Any) -> Matrix:
        """One number per axis, of which `v` may be all."""
        array, n = as_array(v), cls.size - 1
        if array.shape not in ((), (n,)):
            raise SceneError(f"must be one or {COUNTS[n]} numbers, found {describe(v)}")
        return array if array.ndim else np.full(n, float(array))

    # ---- composing and applying --------------------------------------------------------

    @classmethod
    def _product(cls, left: Self, right: Self) -> Self:
        return cls._built(left._matrix @ right._matrix)

    def transform_point(self, p: Any) -> Any:
        """Apply to points.

        The result has the form of `p`: a Dr.Jit array; of three (or two) numbers in a list or tuple, an array of
        `drjit.scalar`; of NumPy and nested lists of shape (.., 3), NumPy in float64.
        """
        if not self.projective:
            return self._apply(self._matrix[:-1], p, 1.0)
        if dr.is_array_v(p):
            *head, last = self._rows(self._matrix, p, 1.0)
            return float_type(p)(*head) / last
        moved = self._apply(self._matrix, np.asarray(p), 1.0)
        found = moved[..., :-1] / moved[..., -1:]
        return ARRAYS[self.size - 1](found) if isinstance(p, (list, tuple)) and found.ndim == 1 else found

    def transform_vector(self, v: Any) -> Any:
        """Apply to vectors, which a translation doesn't change; takes the same forms as `transform_point`."""
        return self._apply(self._matrix[:-1], v, 0.0)

    def transform_normal(self, n: Any) -> Any:
        """Apply to normals, by the inverse transpose; takes the same forms as `transform_point`."""
        return self._apply(self.inverse_transpose[:-1], n, 0.0)

    def _apply(self, rows: Matrix, value: Any, w: float) -> Any:
        n = self.size - 1
        if dr.is_array_v(value) and not dr.is_tensor_v(value) and dr.size_v(value) == n:
            return float_type(value)(*self._rows(rows, value, w))
        points = as_array(value)
        if points.shape[-1:] != (n,):
            raise SceneError(f"points have {COUNTS[n]} coordinates, found {describe(value)} of shape {points.shape}")
        moved = points @ rows[:, :-1].T + w * rows[:, -1]
        return ARRAYS[len(rows)](moved) if isinstance(value, (list, tuple)) and points.ndim == 1 else moved

    @staticmethod
    def _rows(rows: Matrix, value: Any, w: float) -> list[Any]:
        """The products of `rows` with a Dr.Jit array, to which `w` is appended."""
        found = []
        for *linear, constant in rows:
            total = float(constant) * w
            for entry, component in zip(reversed(linear), reversed(list(value)), strict=True):
                total = dr.fma(float(entry), component, total)
            found.append(total)
        return found

    def _treats_alike(self) -> bool:
        return treats_alike(self._matrix)

    # ---- asking ------------------------------------------------------------------------

    def is_singular(self) -> bool:
        """True if the transform flattens shapes, in the precision of float32."""
        linear = self._matrix if self.projective else self._matrix[:-1, :-1]
        if linear.shape == (3, 3) and is_far_from_flat(linear.tolist()):
            return False
        lengths = np.linalg.norm(linear, axis=0)
        if not (lengths > 0).all():
            return True
        return bool(np.linalg.svd(linear / lengths, compute_uv=False)[-1] < FLATTEST)

    def inverse(self) -> Self:
        """The inverse transform; `SceneError` if singular."""
        if self.is_singular():
            raise SceneError("the transform is singular (it flattens shapes) and has no inverse")
        matrix = np.linalg.inv(self._matrix)
        if not self.projective:
            matrix[-1] = self._matrix[-1]
        return type(self)(matrix)

    def transpose(self) -> Self:
        """The transform of the transposed matrix; `SceneError` if that isn't affine."""
        return type(self)(self._matrix.T.copy())

    def translation(self) -> Matrix:
        """The image of the origin, (size - 1,) float64."""
        return self._matrix[:-1, -1].copy()

    @property
    def is_identity(self) -> bool:
        """True if the transform changes nothing."""
        unchanged = IDENTITIES[self.size]
        return self._matrix is unchanged or np.array_equal(self._matrix, unchanged)

    def has_scale(self) -> bool:
        """True if the transform changes lengths or angles; mirroring doesn't."""
        linear = self._matrix[:-1, :-1]
        return bool((np.abs(linear @ linear.T - np.eye(self.size - 1)) > 1e-3).any())

    def update(self) -> Self:
        """The transform itself: there is nothing to bring up to date, unlike in `Transform4f`."""
        return self

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return bool(np.array_equal(self._matrix, other._matrix))

    def __repr__(self) -> str:
        name = type(self).__name__
        rows = (", ".join(f"{x:.9g}" for x in row) for row in self._matrix)
        return f"{name}([" + f",\n{' ' * (len(name) + 2)}".join(f"[{row}]" for row in rows) + "])"


COUNTS = {2: "two", 3: "three"}
ARRAYS = {2: scalar.Array2f, 3: scalar.Array3f}


def float_type(value: Any) -> Any:
    """The type of the transformed `value`: its own, unless that holds integers."""
    return type(value) if dr.is_float_v(value) else dr.float32_array_t(type(value))


class SpatialHostTransform(HostTransform):
    """A transform of space, with the methods that need three axes."""

    __slots__ = ()

    size: ClassVar[int] = 4

    @Chained
    def rotate(kind: Any, axis: Any, angle: Any) -> Matrix:
        """Turn by `angle` degrees about `axis`, counter-clockwise if the axis points at the viewer.

        The axis must have unit length. Another one gives the matrix that Mitsuba makes of it, which scales and shears,
        and a warning.
        """
        return rotation(axis, angle, "rotate", 4)

    @Chained
    def look_at(kind: Any, origin: Any, target: Any, up: Any) -> Matrix:
        """Place a camera at `origin` so that it looks along local +z at `target`, with +y near `up`.

        The columns are left = up x direction, the corrected up, direction and origin; so +x points
        to the left of the image.
        """
        eye, up = kind._per_axis(origin), kind._per_axis(up)
        direction = kind._per_axis(target) - eye
        if not direction.any():
            raise SceneError(f"origin and target are the same point {eye.tolist()}")
        direction /= np.linalg.norm(direction)
        left = cross_product(up, direction)
        length = np.linalg.norm(left)
        if length <= 1e-9 * np.linalg.norm(up):
            raise SceneError(f"up = {up.tolist()} is zero or parallel to the direction of view")
        left /= length
        matrix: Matrix = IDENTITIES[4].copy()
        matrix[:3] = np.stack([left, cross_product(direction, left), direction, eye], axis=1)
        return matrix

    @Chained
    def orthographic(kind: Any, near: Any, far: Any) -> Matrix:
        """Map z from [`near`, `far`] to [0, 1], and keep x and y."""
        low, high = as_number(near), as_number(far)
        if low == high:
            raise SceneError(f"near and far are the same distance {low:g}")
        matrix: Matrix = IDENTITIES[4].copy()
        matrix[2, 2:] = 1 / (high - low), -low / (high - low)
        return matrix

    @Chained
    def to_frame(kind: Any, frame: Any) -> Matrix:
        """Map local coordinates of an orthonormal `frame` (a `Frame3f`) to world space: the columns are its axes."""
        matrix: Matrix = IDENTITIES[4].copy()
        matrix[:3, :3] = np.stack([as_vector(axis) for axis in (frame.s, frame.t, frame.n)], axis=1)
        return matrix

    @Chained
    def from_frame(kind: Any, frame: Any) -> Matrix:
        """Map world space to local coordinates of an orthonormal `frame`: the rows are its axes."""
        matrix: Matrix = IDENTITIES[4].copy()
        matrix[:3, :3] = np.stack([as_vector(axis) for axis in (frame.s, frame.t, frame.n)])
        return matrix


class ScalarTransform4f(SpatialHostTransform):
    """An affine transform of space, immutable: a 4x4 float64 matrix that acts on column vectors.

    Transforms are composed from the right: ``T().translate(v).rotate(axis, angle)`` rotates
    first. Vectors are three numbers in any form (list, NumPy, Dr.Jit, Mitsuba).

    Args:
        matrix: 4x4 numbers in any form, or another transform; default: the identity.

    Raises:
        SceneError: not a 4x4 matrix, not finite, or the last row isn't (0, 0, 0, 1). The
            methods raise it for arguments that they can't use.
    """

    __slots__ = ()

    def extract(self) -> ScalarTransform3f:
        """The transform of x and y: the matrix without its third row and column."""
        return ScalarTransform3f(self._matrix[np.ix_([0, 1, 3], [0, 1, 3])])


class ScalarTransform3f(HostTransform):
    """An affine transform of the plane, immutable: a 3x3 float64 matrix that acts on column vectors.

    Args:
        matrix: 3x3 numbers in any form, or another transform; default: the identity.

    Raises:
        SceneError: not a 3x3 matrix, not finite, or the last row isn't (0, 0, 1).
    """

    __slots__ = ()

    size: ClassVar[int] = 3

    @Chained
    def rotate(kind: Any, angle: Any) -> Matrix:
        """Turn counter-clockwise by `angle` degrees."""
        return rotation_of_plane(angle)

    def expand(self) -> ScalarTransform4f:
        """The transform of space that does the same to x and y, and keeps z: `extract` reversed."""
        matrix: Matrix = IDENTITIES[4].copy()
        matrix[np.ix_([0, 1, 3], [0, 1, 3])] = self._matrix
        return ScalarTransform4f(matrix)


def as_transform(value: Any) -> ScalarTransform4f:
    """Convert any accepted form to an invertible transform.

    Accepted are transforms of djpt and Mitsuba, NumPy arrays, nested lists and Dr.Jit matrices.

    Raises:
        SceneError: not an affine 4x4 matrix, not finite, or singular.
    """
    if value is None:
        raise SceneError("must be a 4x4 matrix, found None")
    transform = ScalarTransform4f(value)
    if transform.is_singular():
        raise SceneError(f"must be invertible, found a singular matrix: {transform.matrix.tolist()}")
    return transform
