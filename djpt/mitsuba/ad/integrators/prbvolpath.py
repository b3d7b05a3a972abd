"""Mitsuba's place of `PRBVolpathIntegrator`."""

from __future__ import annotations

from djpt.mitsuba.volumetric_replay import PRBVolpathIntegrator, index_spectrum

__all__ = ["PRBVolpathIntegrator", "index_spectrum"]
