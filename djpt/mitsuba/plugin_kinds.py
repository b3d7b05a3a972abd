"""Mitsuba's classes of kinds of plugins that djpt divides in another way."""

from __future__ import annotations

from djpt.description.registry import register_phase

__all__ = ["register_phasefunction"]

register_phasefunction = register_phase
"""A former name of `register_phase`."""
