"""The contract of phase functions."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import drjit as dr

from djpt.core.records import PhaseFunctionContext, PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import Plugin
from djpt.dispatch.scripted import accept_scripts
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f

__all__ = ["PhaseFunction", "around"]


class PhaseFunction(Plugin):
    """The distribution of the directions that a medium scatters light to: f(wi, wo), and a way to sample it.

    All methods run in kernels, once per class, with per-lane values (see `djpt.dispatch.ensemble`).

    * `mi.wi` and `wo` are unit vectors in world space that point away from `mi.p`: light that goes straight on has
      wo = -wi. `mi.sh_frame` is a frame around `mi.wi`.
    * Values are per unit solid angle; over all `wo` they integrate to 1, or to a colour below it.
    * `sample` gives a direction, the weight f / pdf, and the density.
    * Where `active` is false the results mean nothing: callers mask.

    Sampling decisions are detached: derivatives are taken from the value of `eval_pdf` at the sampled direction, while
    directions and densities are constants.
    """

    kind: ClassVar[str] = "phase"

    m_flags: int = int(PhaseFunctionFlags.Empty)
    """The flags of a phase function of one component; scripts written for Mitsuba set it."""
    m_components: Sequence[int] = ()
    """The result of `components` unless it is overridden; by default `m_flags` alone."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        accept_scripts(cls, PhaseFunction, CONVERSIONS)

    def components(self) -> tuple[int, ...]:
        """The `PhaseFunctionFlags` of each component, numbered as in `PhaseFunctionContext.component`."""
        return tuple(int(flags) for flags in self.m_components or (self.m_flags,))

    def component_count(self, active: Bool | bool = True) -> int:
        """The number of components."""
        return len(self.components())

    def flags(self, index: int | None = None, active: Bool | bool = True) -> int:
        """The `PhaseFunctionFlags` of all components together, or of component number `index`."""
        components = self.components()
        if index is not None and not isinstance(index, bool):
            return components[index]
        return functools.reduce(operator.or_, components, int(self.m_flags))

    def sample(
        self,
        ctx: PhaseFunctionContext,
        mi: MediumInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Vector3f, Color3f, Float]:
        """Sample `wo`; `sample1` picks the component, `sample2` the direction. Returns `wo`, weight and density."""
        raise NotImplementedError

    def eval_pdf(
        self, ctx: PhaseFunctionContext, mi: MediumInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """The value f(wi, wo), and the density of `sample` at `wo`."""
        raise NotImplementedError

    def projected_area(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Float:
        """The fraction of the medium's extinction that acts on light from `mi.wi`; 1 unless there are microflakes."""
        return Float(1)

    def max_projected_area(self) -> Float:
        """The largest `projected_area`, of all points and directions."""
        return Float(1)


def as_direction(sampled: Sequence[Any]) -> tuple[Vector3f, Color3f, Float]:
    """Convert what a script's `sample` returns."""
    wo, weight, pdf = sampled
    return Vector3f(wo), Color3f(weight), Float(pdf)


def as_value(found: Sequence[Any]) -> tuple[Color3f, Float]:
    """Convert what a script's `eval_pdf` returns."""
    value, pdf = found
    return Color3f(value), Float(pdf)


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "sample": as_direction,
    "eval_pdf": as_value,
    "projected_area": Float,
    "max_projected_area": Float,
}


def around(mi: MediumInteraction3f, cosine: Float, turn: Float) -> Vector3f:
    """The world direction whose cosine with `mi.wi` is `cosine`, turned about `mi.wi` by `turn` in [0, 1)."""
    sine = dr.safe_sqrt(dr.fma(-cosine, cosine, 1))
    sin_phi, cos_phi = dr.sincos(2 * math.pi * turn)
    return mi.to_world(Vector3f(sine * cos_phi, sine * sin_phi, cosine))
