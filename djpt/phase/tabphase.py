"""Phase functions given by numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_array, describe, numbers_in
from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_phase
from djpt.dispatch.tables import entry_at
from djpt.errors import SceneError
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, own_floats
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32, Vector3f
from djpt.phase.base import PhaseFunction, around

__all__ = ["TabulatedPhaseFunction"]


class TabulatedPhaseFunction(PhaseFunction):
    """Numbers at equal steps of the cosine of the angle by which light is turned, -1 (back) to 1 (straight on).

    Between them the phase function is linear; it is divided by its integral.

    Parameters: `values`, at least two numbers that aren't negative, and not all 0: as text ("0.5, 1, 1.5"), a list or
    an array. As a parameter it is a `Float` of any length.
    """

    in_any_frame = True
    m_flags = int(PhaseFunctionFlags.Anisotropic)
    values: ClassVar[Mapping[str, ParamFlags]] = {"intervals": HIDDEN}
    tables: ClassVar[Mapping[str, ParamFlags]] = {"density": ParamFlags.Differentiable, "running": HIDDEN}
    statics: ClassVar[Sequence[str]] = ("steps",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        given = props.raw("values")
        with props.naming("values"):
            self.numbers = as_numbers(numbers_in(given) if isinstance(given, str) else given)
        self._measure()

    def _measure(self) -> None:
        """Compute what kernels read: the density per unit solid angle, and its integral up to each number.

        The density stays attached to the numbers: its derivative includes that of the integral.
        """
        count = len(self.numbers)
        ends = dr.gather(Float, self.numbers, UInt32(0)) + dr.gather(Float, self.numbers, UInt32(count - 1))
        integral = (dr.sum(self.numbers) - 0.5 * ends) * (2 / (count - 1))
        self.density: Any = TensorXf(self.numbers * (dr.rcp(integral) * (1 / (2 * math.pi))), (count,))
        values = np.asarray(dr.detach(self.density), np.float64)
        running = np.cumsum(values[1:] + values[:-1])
        # In memory of Dr.Jit's own: NumPy's is aligned by chance, and another kernel then.
        self.running: Any = TensorXf(own_floats(running / running[-1]), (count - 1,))
        self.intervals = as_float(count - 1)
        self.steps = (count - 2).bit_length()
        """The number of steps of a binary search among the intervals."""

    def traverse(self, callback: TraversalCallback) -> None:
        flags = ParamFlags.Differentiable | ParamFlags.Discontinuous
        callback.put("values", self.numbers, flags, "numbers")

    def check_parameter(self, name: str, value: Any) -> Any:
        return as_numbers(value)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        self._measure()

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        last = UInt32(self.intervals) - 1
        index = UInt32(0)
        for k in reversed(range(self.steps)):
            next_one = index + (1 << k)
            before = entry_at(self.running, dr.minimum(next_one - 1, last), active) < sample2.x
            index = dr.select(before & (next_one <= last), next_one, index)
        low, high = (entry_at(self.density, index + end, active) for end in range(2))
        start = dr.select(index > 0, entry_at(self.running, dr.maximum(index, 1) - 1, active), 0)
        # The integral of the density by the cosine is 1 / (2 pi); the place where the trapezoid is cut by the rest.
        rest = (sample2.x - start) * self.intervals * (1 / (2 * math.pi))
        root = low + dr.safe_sqrt(dr.fma(low, low, rest * (high - low)))
        share = dr.clip(dr.select(root > 0, rest * dr.rcp(root), 0), 0, 1)
        forward = dr.fma(2 * (Float(index) + share), dr.rcp(self.intervals), -1)
        return -around(mi, forward, sample2.y), Color3f(1), dr.fma(high - low, share, low)

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        place = dr.clip((0.5 - 0.5 * dr.dot(wo, mi.wi)), 0, 1) * self.intervals
        first = dr.minimum(dr.floor(place), self.intervals - 1)
        low, high = (entry_at(self.density, UInt32(first) + end, active) for end in range(2))
        pdf = dr.fma(high - low, place - first, low)
        return Color3f(pdf), pdf


def as_numbers(value: Any) -> Float:
    """The numbers of a table, attached to the gradients of `value`.

    Raises:
        SceneError: they can't be a phase function.
    """
    jit = dr.is_array_v(value) and dr.is_jit_v(value)
    numbers = Float(dr.ravel(value)) if jit else Float(as_array(value).ravel().tolist())
    if len(numbers) < 2:
        raise SceneError(f"must be at least two numbers, found {len(numbers)}")
    if not recording():
        found = as_array(dr.detach(numbers))
        if found.min() < 0 or found.max() <= 0:
            raise SceneError(f"must not be negative, and not all 0, found {describe(found.tolist())}")
    return numbers


register_phase("tabphase", TabulatedPhaseFunction)
