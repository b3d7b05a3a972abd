"""Fibres and sheets: microflakes with an SGGX distribution.

The normals of the flakes are those of an ellipsoid, given by a symmetric matrix S, which is positive definite: its
eigenvectors are the axes of the ellipsoid, and its eigenvalues the squares of the areas that flakes of unit area show
along them.

E. Heitz, J. Dupuy, C. Crassin and C. Dachsbacher, "The SGGX Microflake Distribution", ACM Transactions on Graphics
34(4), 2015.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags, Record
from djpt.core.records.interactions import MediumInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_phase
from djpt.errors import ArgumentError, SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float
from djpt.jit.types import Array3f, Bool, Color3f, Float, Normal3f, Point2f, Vector3f, converting
from djpt.phase.base import PhaseFunction
from djpt.textures.texels import numbers_of
from djpt.volumes.base import Volume
from djpt.volumes.gridvolume import GridVolume

__all__ = ["SGGXPhaseFunction", "SGGXPhaseFunctionParams", "sggx_pdf", "sggx_projected_area", "sggx_sample"]


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


class SGGXPhaseFunction(PhaseFunction):
    """Specular microflakes: f = D(h) / (4 sigma(wi)), where h is the unit vector along wi + wo.

    D is the density of the flakes' normals and sigma(wi) the area that they show, which scales the extinction of the
    medium: see `djpt.phase.sggx`.

    Parameters: `S`, a volume of six channels (required), the entries xx, yy, zz, xy, xz, yz of a positive definite
    matrix, in world space. Its eigenvalues are the squares of the areas shown along its eigenvectors; Mitsuba takes for
    granted that they are at most 1, djpt's `max_projected_area` finds the largest one.
    """

    in_any_frame = True
    m_flags = int(PhaseFunctionFlags.Anisotropic | PhaseFunctionFlags.Microflake)
    values: ClassVar[Mapping[str, ParamFlags]] = {"largest": ParamFlags.NonDifferentiable}
    children: ClassVar[Sequence[str]] = ("S",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.S: Volume = props.plugin("S", "volume")
        if self.S.channel_count() != 6:
            raise SceneError(
                f"{props.node}: 'S' must be a volume of six channels, a 'gridvolume' with numbers of the shape "
                f"(z, y, x, 6); found {self.S.channel_count() or 'a constant'}"
            )
        self._measure()

    def _measure(self) -> None:
        """Find the largest area that flakes show: that at a point of the grid, as matrices are interpolated."""
        if not isinstance(self.S, GridVolume):
            self.largest = as_float(1.0)
        elif not recording():
            s = numbers_of(self.S.data).reshape(-1, 6)
            eigenvalues = np.linalg.eigvalsh(s[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3))
            self.largest = as_float(float(np.sqrt(max(eigenvalues.max(), 0.0))))

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("S", self.S)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._measure()

    def _flakes(self, mi: MediumInteraction3f, active: Bool | bool) -> SGGXPhaseFunctionParams:
        return SGGXPhaseFunctionParams(self.S.eval_6(mi, active))

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        flakes = self._flakes(mi, active)
        normal = sggx_sample(mi.sh_frame, sample2, flakes)
        wo = dr.normalize(2 * dr.dot(mi.wi, normal) * normal - mi.wi)
        return wo, Color3f(1), reflected(flakes, mi.wi, normal)

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        pdf = reflected(self._flakes(mi, active), mi.wi, dr.normalize(wo + mi.wi))
        return Color3f(pdf), pdf

    def projected_area(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Float:
        return sggx_projected_area(mi.wi, self._flakes(mi, active))

    def max_projected_area(self) -> Float:
        return self.largest


def reflected(flakes: SGGXPhaseFunctionParams, wi: Vector3f, normal: Vector3f) -> Float:
    """The density of light from `wi` that flakes with a normal reflect, per unit solid angle."""
    return 0.25 * sggx_pdf(normal, flakes) * dr.rcp(sggx_projected_area(wi, flakes))


register_phase("sggx", SGGXPhaseFunction)
