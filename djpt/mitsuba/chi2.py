"""Pearson's test for sampling methods under the name that Mitsuba scripts use."""

from __future__ import annotations

from djpt.mitsuba.chi_squared import ChiSquareTest, LineDomain, PlanarDomain, SphericalDomain
from djpt.mitsuba.chi_squared_adapters import (
    BSDFAdapter,
    EmitterAdapter,
    MicrofacetAdapter,
    PhaseFunctionAdapter,
    SpectrumAdapter,
)

__all__ = [
    "BSDFAdapter",
    "ChiSquareTest",
    "EmitterAdapter",
    "LineDomain",
    "MicrofacetAdapter",
    "PhaseFunctionAdapter",
    "PlanarDomain",
    "SpectrumAdapter",
    "SphericalDomain",
]
