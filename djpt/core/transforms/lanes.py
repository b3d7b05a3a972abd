"""Transforms of Dr.Jit matrices: one per lane, differentiable. Scripts compute with them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_number, as_type, describe
from djpt.core.transforms.base import (
    Chained,
    Transform,
    is_unit,
    matrix_of,
    rotation_of_plane,
    treats_alike,
    warn_of_length,
)
from djpt.core.transforms.host import HostTransform, ScalarTransform3f, ScalarTransform4f, SpatialHostTransform
from djpt.errors import SceneError
from djpt.jit.types import Array3f, Bool, Matrix4f, backend

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "AffineTransform3d",
    "AffineTransform3f",
    "AffineTransform4d",
    "AffineTransform4f",
    "ProjectiveTransform3d",
    "ProjectiveTransform3f",
    "ProjectiveTransform4d",
    "ProjectiveTransform4f",
    "ScalarAffineTransform3d",
    "ScalarAffineTransform3f",
    "ScalarAffineTransform4d",
    "ScalarAffineTransform4f",
    "ScalarProjectiveTransform3d",
    "ScalarProjectiveTransform3f",
    "ScalarProjectiveTransform4d",
    "ScalarProjectiveTransform4f",
    "ScalarTransform3d",
    "ScalarTransform4d",
    "Transform3d",
    "Transform3f",
    "Transform4d",
    "Transform4f",
]


class LaneTransform(Transform):
    """A transform of Dr.Jit matrices.

    Args:
        matrix: a Dr.Jit matrix, numbers in nested lists or NumPy (the last axis may be lanes), or another transform;
            default: the identity.
        inverse_transpose: the transposed inverse of `matrix`; default: computed.

    Raises:
        SceneError: `matrix` can't be converted.
    """

    on_lanes: ClassVar[bool] = True
    Matrix: ClassVar[Any]
    """The type of the matrix."""
    Vector: ClassVar[Any]
    """The type of points and vectors."""
    DRJIT_STRUCT: ClassVar[dict[str, Any]]

    def __init_subclass__(cls) -> None:
        if hasattr(cls, "Matrix"):
            cls.DRJIT_STRUCT = {"matrix": cls.Matrix, "inverse_transpose": cls.Matrix}

    def __init__(self, matrix: Any = None, inverse_transpose: Any = None) -> None:
        kind = type(self)
        if isinstance(matrix, LaneTransform):
            self._matrix, self._inverse_transpose = kind._converted(matrix), kind.Matrix(matrix.inverse_transpose)
        else:
            self._matrix = kind.Matrix(1) if matrix is None else kind._converted(matrix)
            if matrix is None:
                self._inverse_transpose = kind.Matrix(1)
            elif inverse_transpose is None:
                self.update()
            else:
                self._inverse_transpose = kind.Matrix(inverse_transpose)
        self._declare_alike(matrix is None or (isinstance(matrix, LaneTransform) and matrix._treats_alike()))

    @classmethod
    def _converted(cls, value: Any) -> Any:
        """`value`, a transform or numbers, as a matrix."""
        found = matrix_of(value)
        try:
            # Dr.Jit pads a smaller matrix.
            if dr.is_array_v(found) and dr.is_matrix_v(found) and dr.size_v(found) != cls.size:
                raise TypeError
            # Numbers of NumPy become constants that Python knows, unless there is one matrix per lane.
            return cls.Matrix(found.tolist() if isinstance(found, np.ndarray) and found.ndim == 2 else found)
        except Exception:
            raise SceneError(f"must be a {cls.size}x{cls.size} matrix, found {describe(value)}") from None

    @property
    def matrix(self) -> Any:
        """The Dr.Jit matrix. After an edit of it, `update` renews what else is derived from it."""
        return self._matrix

    @matrix.setter
    def matrix(self, value: Any) -> None:
        self._matrix = self._converted(value)

    @property
    def inverse_transpose(self) -> Any:
        """The transposed inverse of the matrix, which normals are transformed by."""
        return self._inverse_transpose

    @inverse_transpose.setter
    def inverse_transpose(self, value: Any) -> None:
        self._inverse_transpose = type(self).Matrix(value)
        self._declare_alike(False)

    def update(self) -> Self:
        """Compute `inverse_transpose` from the matrix."""
        if self.projective:
            self._inverse_transpose = dr.rcp(self._matrix).T
            return self
        n = self.size - 1
        linear = SMALLER[self.Matrix]([[self._matrix[i, j] for j in range(n)] for i in range(n)])
        inverse = dr.rcp(linear)
        moved = [-sum(inverse[i, j] * self._matrix[j, n] for j in range(n)) for i in range(n)]
        rows = [[inverse[j, i] for j in range(n)] + [0] for i in range(n)]
        self._inverse_transpose = self.Matrix([*rows, [*moved, 1]])
        return self

    def assign(self, other: Any) -> None:
        """Become equal to another transform of the same size."""
        copied = type(self)(other)
        self._matrix, self._inverse_transpose = copied._matrix, copied._inverse_transpose
        self._declare_alike(copied._treats_alike())

    def __setitem__(self, mask: Any, value: Any) -> None:
        """Become equal to another transform on the lanes where `mask` is true."""
        other = self._of(value)
        alike = self._treats_alike() and other._treats_alike()
        self._matrix = dr.select(mask, other._matrix, self._matrix)
        self._inverse_transpose = dr.select(mask, other._inverse_transpose, self._inverse_transpose)
        self._declare_alike(alike)

    # ---- building, from the right ----------------------------------------------------

    @classmethod
    def _made(cls, matrix: Any, inverse_transpose: Any, alike: bool = False) -> Self:
        """A transform of which the inverse is known; `alike` says whether it treats points, vectors, normals alike."""
        made = cls(cls.Matrix(matrix), cls.Matrix(inverse_transpose))
        made._declare_alike(alike)
        return made

    @classmethod
    def _vector(cls, value: Any) -> Any:
        """One Dr.Jit number per axis."""
        return as_type(cls.Vector, value)

    @classmethod
    def _number(cls, value: Any) -> Any:
        """A Dr.Jit number."""
        return as_type(dr.value_t(cls.Vector), value)

    @Chained
    def translate(kind: Any, v: Any) -> Any:
        """Move by `v`."""
        v, n = kind._vector(v), kind.size - 1
        there, back = (kind.Matrix(1) for _ in range(2))
        for i in range(n):
            there[i, n], back[n, i] = v[i], -v[i]
        return kind._made(there, back)

    @Chained
    def scale(kind: Any, v: Any) -> Any:
        """Scale by a number, or by one per axis."""
        single = dr.is_array_v(v) and dr.depth_v(v) == 1 and dr.size_v(v) != kind.size - 1
        uniform = single or isinstance(v, (int, float, np.number))
        v = kind._vector(v)
        return kind._made(diagonal([*v, 1]), diagonal([*dr.rcp(v), 1]), uniform)

    # ---- composing and applying --------------------------------------------------------

    @classmethod
    def _product(cls, left: Self, right: Self) -> Self:
        a, b, c, d = left._matrix, right._matrix, left.inverse_transpose, right.inverse_transpose
        alike = left._treats_alike() and right._treats_alike()
        if cls.projective:
            return cls._made(a @ b, c @ d, alike)
        n = cls.size - 1
        top = [[dot(a[i], b, j, n) for j in range(n)] + [dot(a[i], b, n, n, a[i, n])] for i in range(n)]
        linear = [[dot(c[i], d, j, n) for j in range(n)] + [0] for i in range(n)]
        corner = [dot(c[n], d, j, n, d[n, j]) for j in range(n)]
        last = [0] * n + [1]
        return cls._made([*top, last], [*linear, [*corner, 1]], alike)

    def transform_point(self, p: Any) -> Any:
        """Apply to points; divides by the last coordinate if the transform is projective."""
        p, m, n = self._vector(p), self._matrix, self.size - 1
        rows = []
        for i in range(self.size if self.projective else n):
            total = m[i, n]
            for j in range(n):
                total = dr.fma(m[i, j], p[j], total)
            rows.append(total)
        return self.Vector(*rows[:n]) / rows[n] if self.projective else self.Vector(*rows)

    def transform_vector(self, v: Any) -> Any:
        """Apply to vectors, which a translation doesn't change."""
        return self._linear(self._matrix, v)

    def transform_normal(self, n: Any) -> Any:
        """Apply to normals, by the inverse transpose; their length changes."""
        return self._linear(self.inverse_transpose, n)

    def _linear(self, matrix: Any, value: Any) -> Any:
        v, n = self._vector(value), self.size - 1
        rows = []
        for i in range(n):
            total = matrix[i, 0] * v[0]
            for j in range(1, n):
                total = dr.fma(matrix[i, j], v[j], total)
            rows.append(total)
        return self.Vector(*rows)

    def _declare_alike(self, alike: bool) -> None:
        """Note that the present matrix treats points, vectors and normals alike, or that nothing is known of it.

        The note is a copy, which edits of the matrix don't reach.
        """
        self._alike = type(self).Matrix(self._matrix) if alike else None

    def _treats_alike(self) -> bool:
        if self._alike is not None:
            noted, present = (dr.detail.collect_indices(m) for m in (self._alike, self._matrix))
            if noted == present:
                return True
        # Numbers that Python knows speak for themselves.
        n, m = self.size - 1, self._matrix
        if not all(is_known(m[i, n]) and m[i, n][0] == 0 for i in range(n)):
            return False
        entries = [[m[i, j] for j in range(n + 1)] for i in range(n + 1)]
        if not all(is_known(x) for row in entries for x in row):
            return False
        return treats_alike(np.array([[x[0] for x in row] for row in entries], np.float64))

    # ---- asking ------------------------------------------------------------------------

    def inverse(self) -> Self:
        """The inverse transform; not finite where the transform is singular."""
        return self._made(self.inverse_transpose.T, self._matrix.T, self._treats_alike())

    def translation(self) -> Any:
        """The image of the origin."""
        return self.Vector(*(self._matrix[i, self.size - 1] for i in range(self.size - 1)))

    def has_scale(self) -> Bool:
        """True where the transform changes lengths or angles; mirroring doesn't."""
        m, n = self._matrix, self.size - 1
        found = Bool(False)
        for i in range(n):
            for j in range(i, n):
                product = sum(m[i, k] * m[j, k] for k in range(n))
                found |= dr.abs(product - float(i == j)) > 1e-3
        return found

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Transform) or (other.size, other.projective) != (self.size, self.projective):
            return NotImplemented
        return bool(dr.all(self._matrix == self._of(other)._matrix, axis=None))

    def __repr__(self) -> str:
        parts = (("matrix", self._matrix), ("inverse_transpose", self.inverse_transpose))
        lines = (f"  {name}=" + str(value).replace("\n", "\n" + " " * (len(name) + 3)) for name, value in parts)
        return "Transform[\n" + ",\n".join(lines) + "\n]"


SMALLER = {
    backend.Matrix4f: backend.Matrix3f,
    backend.Matrix3f: backend.Matrix2f,
    backend.Matrix4f64: backend.Matrix3f64,
    backend.Matrix3f64: backend.Matrix2f64,
}
"""The types of the linear parts of matrices."""


def is_known(x: Any) -> bool:
    """True if Python knows the number, which is the same on all lanes, without running a kernel."""
    return bool(x.state == dr.VarState.Literal and dr.width(x) == 1 and not dr.grad_enabled(x))


def diagonal(entries: list[Any]) -> list[list[Any]]:
    """The rows of a diagonal matrix."""
    return [[x if i == j else 0 for j in range(len(entries))] for i, x in enumerate(entries)]


def dot(row: Any, matrix: Any, j: int, n: int, start: Any = 0) -> Any:
    """`start` plus the product of the first `n` entries of a row and of column `j` of a matrix."""
    total = start
    for k in range(n):
        total = dr.fma(row[k], matrix[k, j], total)
    return total


class SpatialLaneTransform(LaneTransform):
    """A transform of space, with the methods that need three axes."""

    size: ClassVar[int] = 4

    @Chained
    def rotate(kind: Any, axis: Any, angle: Any) -> Any:
        """Turn by `angle` degrees about `axis`, counter-clockwise if the axis points at the viewer.

        The axis must have unit length. Another one gives the matrix that Mitsuba makes of it, which scales and shears,
        and a warning if its numbers are known to Python.
        """
        x, y, z = a = kind._vector(axis)
        known = all(is_known(component) for component in a)
        length = math.hypot(*(component[0] for component in a)) if known else 1.0
        unit = is_unit(length)
        if not unit:
            warn_of_length(length, "rotate", 4)
        sine, cosine = dr.sincos(dr.deg2rad(kind._number(angle)))
        cross = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        # O. Rodrigues: R = cos(a) I + sin(a) K + (1 - cos(a)) x x^T
        rows = [
            [dr.fma(a[i] * a[j], 1 - cosine, sine * cross[i][j] if i != j else cosine) for j in range(3)] + [0]
            for i in range(3)
        ]
        matrix = [*rows, [0, 0, 0, 1]]
        return kind._made(matrix, matrix, True) if unit else kind(matrix)

    @Chained
    def look_at(kind: Any, origin: Any, target: Any, up: Any) -> Any:
        """Place a camera at `origin` so that it looks along local +z at `target`, with +y near `up`."""
        eye = kind._vector(origin)
        direction = dr.normalize(kind._vector(target) - eye)
        left = dr.normalize(dr.cross(kind._vector(up), direction))
        axes = [left, dr.cross(direction, left), direction]
        matrix = [[*(axis[i] for axis in axes), eye[i]] for i in range(3)]
        inverse = [[*(axis[i] for axis in axes), 0] for i in range(3)]
        return kind._made([*matrix, [0, 0, 0, 1]], [*inverse, [*(-dr.dot(axis, eye) for axis in axes), 1]])

    @Chained
    def orthographic(kind: Any, near: Any, far: Any) -> Any:
        """Map z from [`near`, `far`] to [0, 1], and keep x and y."""
        near, far = kind._number(near), kind._number(far)
        return kind.scale([1, 1, dr.rcp(far - near)]).translate([0, 0, -near])

    @Chained
    def to_frame(kind: Any, frame: Any) -> Any:
        """Map local coordinates of an orthonormal `frame` (a `Frame3f`) to world space: the columns are its axes."""
        axes = [kind._vector(axis) for axis in (frame.s, frame.t, frame.n)]
        matrix = [[*(axis[i] for axis in axes), 0] for i in range(3)] + [[0, 0, 0, 1]]
        return kind._made(matrix, matrix, True)

    @Chained
    def from_frame(kind: Any, frame: Any) -> Any:
        """Map world space to local coordinates of an orthonormal `frame`: the rows are its axes."""
        axes = [kind._vector(axis) for axis in (frame.s, frame.t, frame.n)]
        matrix = [[*axis, 0] for axis in axes] + [[0, 0, 0, 1]]
        return kind._made(matrix, matrix, True)


class PlanarLaneTransform(LaneTransform):
    """A transform of the plane, with the methods that need two axes."""

    size: ClassVar[int] = 3

    @Chained
    def rotate(kind: Any, angle: Any) -> Any:
        """Turn counter-clockwise by `angle` degrees."""
        sine, cosine = dr.sincos(dr.deg2rad(kind._number(angle)))
        matrix = [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]
        return kind._made(matrix, matrix, True)


class AffineTransform3f(PlanarLaneTransform):
    """An affine transform of the plane: a 3x3 matrix per lane."""

    Matrix: ClassVar[Any] = backend.Matrix3f
    Vector: ClassVar[Any] = backend.Array2f


class AffineTransform4f(SpatialLaneTransform):
    """An affine transform of space: a 4x4 matrix per lane. `ScalarTransform4f` is the form of scene descriptions."""

    Matrix: ClassVar[Any] = Matrix4f
    Vector: ClassVar[Any] = Array3f
    Extracted: ClassVar[type[LaneTransform]] = AffineTransform3f
    """The class of the result of `extract`."""

    def extract(self) -> Any:
        """The transform of x and y: the matrix without its third row and column."""
        kept = [0, 1, 3]
        matrix, inverse_transpose = (
            [[part[i, j] for j in kept] for i in kept] for part in (self._matrix, self.inverse_transpose)
        )
        return self.Extracted._made(matrix, inverse_transpose)


Transform3f, Transform4f = AffineTransform3f, AffineTransform4f


# ---- projective transforms, and those of double precision ------------------------------------


class ProjectiveTransform3f(PlanarLaneTransform):
    """A projective transform of the plane: any 3x3 matrix per lane; points are divided by the last coordinate."""

    projective: ClassVar[bool] = True
    Matrix: ClassVar[Any] = backend.Matrix3f
    Vector: ClassVar[Any] = backend.Array2f


class ProjectiveTransform4f(SpatialLaneTransform):
    """A projective transform of space: any 4x4 matrix per lane; points are divided by the last coordinate."""

    projective: ClassVar[bool] = True
    Matrix: ClassVar[Any] = Matrix4f
    Vector: ClassVar[Any] = Array3f

    @Chained
    def perspective(kind: Any, fov: Any, near: Any, far: Any) -> Any:
        """Project points along z to the plane z = 1: ``x / z``, ``y / z``, and z from [`near`, `far`] to [0, 1].

        `fov` is the angle in degrees that is mapped to [-1, 1].
        """
        near, far = kind._number(near), kind._number(far)
        tangent = dr.tan(dr.deg2rad(kind._number(fov) * 0.5))
        share = far / (far - near)
        matrix = [[1 / tangent, 0, 0, 0], [0, 1 / tangent, 0, 0], [0, 0, share, -near * share], [0, 0, 1, 0]]
        # The inverse, by rows: (tangent, 0, 0, 0), (0, tangent, 0, 0), (0, 0, 0, 1), (0, 0, last, 1 / near).
        last = (near - far) / (far * near)
        inverse_transpose = [[tangent, 0, 0, 0], [0, tangent, 0, 0], [0, 0, 0, last], [0, 0, 1, dr.rcp(near)]]
        return kind._made(matrix, inverse_transpose)


class AffineTransform3d(AffineTransform3f):
    """`AffineTransform3f` in double precision."""

    Matrix: ClassVar[Any] = backend.Matrix3f64
    Vector: ClassVar[Any] = backend.Array2f64


class AffineTransform4d(AffineTransform4f):
    """`AffineTransform4f` in double precision."""

    Matrix: ClassVar[Any] = backend.Matrix4f64
    Vector: ClassVar[Any] = backend.Array3f64
    Extracted = AffineTransform3d


class ProjectiveTransform3d(ProjectiveTransform3f):
    """`ProjectiveTransform3f` in double precision."""

    Matrix: ClassVar[Any] = backend.Matrix3f64
    Vector: ClassVar[Any] = backend.Array2f64


class ProjectiveTransform4d(ProjectiveTransform4f):
    """`ProjectiveTransform4f` in double precision."""

    Matrix: ClassVar[Any] = backend.Matrix4f64
    Vector: ClassVar[Any] = backend.Array3f64


class ScalarProjectiveTransform3f(HostTransform):
    """A projective transform of the plane on the host: any 3x3 matrix."""

    size: ClassVar[int] = 3
    projective: ClassVar[bool] = True

    @Chained
    def rotate(kind: Any, angle: Any) -> Any:
        """Turn counter-clockwise by `angle` degrees."""
        return rotation_of_plane(angle)


class ScalarProjectiveTransform4f(SpatialHostTransform):
    """A projective transform of space on the host: any 4x4 matrix."""

    projective: ClassVar[bool] = True

    @Chained
    def perspective(kind: Any, fov: Any, near: Any, far: Any) -> Any:
        """Project points along z to the plane z = 1: see `ProjectiveTransform4f.perspective`."""
        low, high = as_number(near), as_number(far)
        tangent = np.tan(np.radians(as_number(fov)) / 2)
        if low == high or tangent == 0:
            raise SceneError(f"no frustum has fov {fov}, near {near} and far {far}")
        share = high / (high - low)
        return np.array(
            [[1 / tangent, 0, 0, 0], [0, 1 / tangent, 0, 0], [0, 0, share, -low * share], [0, 0, 1, 0]], np.float64
        )


Transform3d, Transform4d = AffineTransform3d, AffineTransform4d

# On the host all numbers are float64.
ScalarTransform3d = ScalarAffineTransform3f = ScalarAffineTransform3d = ScalarTransform3f
ScalarTransform4d = ScalarAffineTransform4f = ScalarAffineTransform4d = ScalarTransform4f
ScalarProjectiveTransform3d = ScalarProjectiveTransform3f
ScalarProjectiveTransform4d = ScalarProjectiveTransform4f
