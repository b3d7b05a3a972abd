"""Fibres and sheets: microflakes with an SGGX distribution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import drjit as dr
import numpy as np

from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_phase
from djpt.errors import SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f
from djpt.phase.base import PhaseFunction
from djpt.phase.microflakes import SGGXPhaseFunctionParams, sggx_pdf, sggx_projected_area, sggx_sample
from djpt.textures.texels import numbers_of
from djpt.volumes.base import Volume
from djpt.volumes.gridvolume import GridVolume

__all__ = ["SGGXPhaseFunction"]


class SGGXPhaseFunction(PhaseFunction):
    """Specular microflakes: f = D(h) / (4 sigma(wi)), where h is the unit vector along wi + wo.

    D is the density of the flakes' normals and sigma(wi) the area that they show, which scales the extinction of the
    medium: see `djpt.phase.microflakes`.

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
