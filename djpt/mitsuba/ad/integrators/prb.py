"""Mitsuba's place of `PRBIntegrator`."""

from __future__ import annotations

from djpt.mitsuba.path_replay import PRBIntegrator

__all__ = ["PRBIntegrator"]
