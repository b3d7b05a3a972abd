"""Rules of numerical integration under the name that Mitsuba scripts use."""

from __future__ import annotations

from djpt.mitsuba.quadrature import chebyshev, composite_simpson, composite_simpson_38, gauss_legendre, gauss_lobatto

__all__ = ["chebyshev", "composite_simpson", "composite_simpson_38", "gauss_legendre", "gauss_lobatto"]
