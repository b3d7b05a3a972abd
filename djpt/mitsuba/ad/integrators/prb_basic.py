"""Mitsuba's place of `BasicPRBIntegrator`."""

from __future__ import annotations

from djpt.mitsuba.path_replay import BasicPRBIntegrator

__all__ = ["BasicPRBIntegrator"]
