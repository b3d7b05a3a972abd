"""Media that vary in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.records import Ray3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import HIDDEN, ParamFlags, Plugin
from djpt.description.properties import Properties
from djpt.description.registry import register_medium
from djpt.dispatch.tables import entry_at
from djpt.jit.kernels import as_float, as_vector, maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, TensorXf, UInt32, Vector3f
from djpt.media.base import MeasuredMedium
from djpt.media.tracking import Majorants

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Heterogeneous"]

POINTS, MOST = 8, 16
"""The points of a grid along an axis that share a majorant, at least, and the most majorants along an axis."""

AHEAD = 4e-5
"""The share of a cell by which a place is moved on, so that one on a border belongs to the cell that the ray enters."""


class Heterogeneous(MeasuredMedium):
    """Smoke: sigma_t varies in space, within the box of its volume; there is nothing outside it.

    Distances are sampled by delta tracking, the transmittance of shadow rays is estimated by ratio tracking: see
    `djpt.media.tracking`. Of a grey grid, each collision reads one number in place of the eight around it, and
    majorants are local: a coarser grid has the maximum of each of its cells.

    Parameters: `sigma_t` (extinction per unit length: a volume, usually a `gridvolume`, >= 0, default 1), `scale` (a
    factor of it, default 1), `albedo` (the scattered fraction: a number, rgb or volume in [0, 1], default 0.75),
    `has_spectral_extinction` (default true; false: `sigma_t` is grey), a phase function, `sample_emitters` and
    `emission`. Nothing glows outside of the box of `sigma_t`.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        "scale": ParamFlags.Differentiable,
        **dict.fromkeys(("low", "high", "cell_x", "cell_y", "cell_z", "cell_origin", "counts", "largest"), HIDDEN),
    }
    tables: ClassVar[Mapping[str, ParamFlags]] = {"maxima": HIDDEN}
    statics: ClassVar[Sequence[str]] = ("m_sample_emitters", "m_has_spectral_extinction", "has_cells")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.has_cells: bool
        self.maxima: Any
        self._place()

    def _place(self) -> None:
        """Compute the data of the whole volume that kernels use: its box, and the majorants."""
        box = self.sigma_t.bbox()
        self.low, self.high = as_vector(np.array(box.min)), as_vector(np.array(box.max))
        largest = self.sigma_t.max()
        self.largest = as_float(largest)
        counts, maxima = np.ones(3), np.full(1, largest, np.float32)
        matrix = np.eye(4)[:3]
        # Beyond the border of a grid that repeats, cells say nothing.
        if getattr(self.sigma_t, "wrap_mode", None) == "clamp":
            counts = np.clip(np.array(self.sigma_t.resolution()) // POINTS, 1, MOST)
        self.has_cells = bool(counts.prod() > 1)
        if self.has_cells:
            maxima = self.sigma_t.cell_maxima([int(n) for n in counts]).ravel()
            matrix = counts[:, None] * self.sigma_t.placement().inverse().matrix[:3]
        self.maxima = TensorXf(maxima)
        self.counts = as_vector(counts.astype(float))
        self.cell_x, self.cell_y, self.cell_z = (as_vector(row[:3]) for row in matrix)
        self.cell_origin = as_vector(matrix[:, 3])

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._place()

    def of_extinction(self) -> Sequence[Plugin]:
        return [self, self.sigma_t, self.phase] if self.is_of_flakes() else [self, self.sigma_t]

    def move_into(self, frame: Frame) -> None:
        super().move_into(frame)
        self._place()

    # ---- coefficients ------------------------------------------------------------------

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        return Color3f(self.largest * self.scale)

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        sigma_t = self.extinction(mi, active)
        return sigma_t * self.albedo.eval(mi, active), self.get_majorant(mi) - sigma_t, sigma_t

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        inverse = dr.rcp(ray.d)
        a, b = (self.low - ray.o) * inverse, (self.high - ray.o) * inverse
        near, far = dr.minimum(a, b), dr.maximum(a, b)
        mint, maxt = dr.max(near), dr.min(far)
        return (mint <= maxt) & (maxt > 0), mint, maxt

    # ---- tracking ------------------------------------------------------------------------

    def extinction(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.effective(self.sigma_t.eval(mi, active), mi, active)

    def extinction_at(self, mi: MediumInteraction3f, u: Float, active: Bool | bool = True) -> Color3f:
        # Single numbers of a coloured grid would make the weights of the channels noisy.
        if self.has_spectral_extinction():
            return self.extinction(mi, active)
        return self.effective(self.sigma_t.pick(mi, u, active), mi, active)

    def albedo_at(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.albedo.eval(mi, active)

    def majorants(self, ray: Ray3f) -> Majorants:
        if not self.has_cells:
            return super().majorants(ray)
        rows = (self.cell_x, self.cell_y, self.cell_z)
        o = Vector3f(*(dr.dot(row, ray.o) for row in rows)) + self.cell_origin
        d = Vector3f(*(dr.dot(row, ray.d) for row in rows))
        inverse = dr.rcp(d)
        up = d > 0
        ahead = dr.select(up, AHEAD, -AHEAD)
        least = AHEAD * dr.min(dr.abs(inverse))

        def majorant(t: Float, active: Bool | bool) -> tuple[Float, Float]:
            place = dr.fma(d, t, o)
            cell = Vector3f(*(clipped(x, n) for x, n in zip(dr.floor(place + ahead), self.counts, strict=True)))
            to_border = (dr.select(up, cell + 1, cell) - place) * inverse
            # Beyond the grid its outermost cells go on for ever; and no border is reached along other axes.
            to_border = dr.select(to_border > 0, to_border, dr.inf)
            x, y, z = (UInt32(c) for c in cell)
            index = dr.fma(dr.fma(z, UInt32(self.counts.y), y), UInt32(self.counts.x), x)
            return self.scale * entry_at(self.maxima, index, active), t + maximum(dr.min(to_border), least)

        return majorant


def clipped(x: Float, count: Float) -> Float:
    """The number of a cell, at least 0 and below `count`; also for NaN."""
    return minimum(maximum(x, Float(0)), count - 1)


register_medium("heterogeneous", Heterogeneous)
