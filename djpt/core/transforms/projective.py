"""The transforms that only scripts use: projective ones, and those of double precision."""

from __future__ import annotations

from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_number
from djpt.core.transforms.base import Chained
from djpt.core.transforms.host import HostTransform, ScalarTransform3f, ScalarTransform4f, SpatialHostTransform
from djpt.core.transforms.lanes import AffineTransform3f, AffineTransform4f, PlanarLaneTransform, SpatialLaneTransform
from djpt.core.transforms.matrices import rotation_of_plane
from djpt.errors import SceneError
from djpt.jit.types import Array3f, Matrix4f, backend

__all__ = [
    "AffineTransform3d",
    "AffineTransform4d",
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
    "Transform4d",
]


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
