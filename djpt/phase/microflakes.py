"""The SGGX distribution of microflakes: the normals of an ellipsoid, given by a symmetric matrix S.

E. Heitz, J. Dupuy, C. Crassin and C. Dachsbacher, "The SGGX Microflake Distribution", ACM Transactions on Graphics
34(4), 2015. S is positive definite; its eigenvectors are the axes of the ellipsoid, and its eigenvalues the squares of
the areas that flakes of unit area show along them.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import Record
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.errors import ArgumentError
from djpt.jit.types import Array3f, Float, Normal3f, Point2f, Vector3f, converting

__all__ = ["SGGXPhaseFunctionParams", "sggx_pdf", "sggx_projected_area", "sggx_sample"]


class SGGXPhaseFunctionParams(Record):
    """The matrix S: made of ``(diag, off_diag)``, of a list of six numbers, or of other parameters."""

    diag: Array3f
    """S_xx, S_yy, S_zz."""
    off_diag: Array3f
    """S_xy, S_xz, S_yz."""

    def __init__(self, diag: Any = None, off_diag: Any = None) -> None:
        if isinstance(diag, SGGXPhaseFunctionParams):
            super().__init__(diag)
        elif diag is None:
            super().__init__()
        elif off_diag is not None:
            super().__init__(diag=diag, off_diag=off_diag)
        elif len(diag) == 6:
            super().__init__(diag=Array3f(*diag[:3]), off_diag=Array3f(*diag[3:]))
        else:
            raise ArgumentError(f"SGGXPhaseFunctionParams: takes six numbers or two arrays of three, found {len(diag)}")

    def times(self, v: Vector3f) -> Vector3f:
        """The product S v."""
        d, o = self.diag, self.off_diag
        return Vector3f(
            dr.fma(d.x, v.x, dr.fma(o.x, v.y, o.y * v.z)),
            dr.fma(o.x, v.x, dr.fma(d.y, v.y, o.z * v.z)),
            dr.fma(o.y, v.x, dr.fma(o.z, v.y, d.z * v.z)),
        )

    def adjugate(self) -> SGGXPhaseFunctionParams:
        """The inverse of S times its determinant."""
        d, o = self.diag, self.off_diag
        diag = Array3f(dr.fma(d.y, d.z, -o.z * o.z), dr.fma(d.x, d.z, -o.y * o.y), dr.fma(d.x, d.y, -o.x * o.x))
        off_diag = Array3f(dr.fma(o.y, o.z, -o.x * d.z), dr.fma(o.x, o.z, -o.y * d.y), dr.fma(o.x, o.y, -o.z * d.x))
        return SGGXPhaseFunctionParams.holding(diag=diag, off_diag=off_diag)

    def determinant(self) -> Float:
        """The determinant of S, without the sign that rounding may give it."""
        adjugate = self.adjugate()
        first = dr.fma(self.off_diag.x, adjugate.off_diag.x, self.off_diag.y * adjugate.off_diag.y)
        return dr.abs(dr.fma(self.diag.x, adjugate.diag.x, first))


def matrix(s: Any) -> SGGXPhaseFunctionParams:
    """The matrix S in any form."""
    return s if isinstance(s, SGGXPhaseFunctionParams) else SGGXPhaseFunctionParams(s)


@converting
def sggx_sample(sh_frame: Any, sample: Point2f, s: Any) -> Normal3f:
    """Sample a normal by the area that its flakes show to the direction of `sh_frame.n`.

    Args:
        sh_frame: a frame about the direction that the flakes are seen from, or that direction.
        sample: uniform.
        s: the parameters, or six numbers.

    Returns:
        The normal in world space, on the side that is seen.
    """
    frame = sh_frame if isinstance(sh_frame, Frame3f) else Frame3f(sh_frame)
    s = matrix(s)
    along_t, along_n = s.times(frame.t), s.times(frame.n)
    # S in the coordinates of the frame: its triangular root maps the hemisphere to the side that is seen.
    tt, nn = dr.dot(frame.t, along_t), dr.dot(frame.n, along_n)
    st, sn, tn = dr.dot(frame.s, along_t), dr.dot(frame.s, along_n), dr.dot(frame.t, along_n)
    inverse_root = dr.rsqrt(dr.maximum(nn, SMALLEST))
    part = dr.safe_sqrt(dr.fma(tt, nn, -tn * tn))
    inverse_part = dr.rcp(dr.maximum(part, SMALLEST))
    u, v, w = square_to_cosine_hemisphere(sample)
    v, w = v * inverse_root, w * inverse_root
    local = Vector3f(
        dr.fma(w, sn, dr.fma(v, dr.fma(st, nn, -sn * tn) * inverse_part, u * dr.sqrt(s.determinant()) * inverse_part)),
        dr.fma(w, tn, v * part),
        w * nn,
    )
    return frame.to_world(dr.normalize(local))


@converting
def sggx_pdf(wm: Vector3f, s: Any) -> Float:
    """The density of flakes by the direction of their normal, `wm` of unit length, per unit solid angle."""
    s = matrix(s)
    determinant = s.determinant()
    size = dr.dot(wm, s.adjugate().times(wm))
    return determinant * dr.sqrt(determinant) * dr.rcp(math.pi * size * size)


@converting
def sggx_projected_area(wi: Vector3f, s: Any) -> Float:
    """The area that flakes of unit area show to the direction `wi`, on average: the root of wi S wi."""
    return dr.safe_sqrt(dr.dot(wi, matrix(s).times(wi)))


SMALLEST = 1e-30
"""The divisor in place of an area of flakes that is 0, since none is seen."""
