"""Mitsuba's module of `BasicPRBIntegrator`."""

from __future__ import annotations

from djpt.mitsuba.ad.integrators.prb import BasicPRBIntegrator

__all__ = ["BasicPRBIntegrator"]
