"""Mitsuba's place of `djpt.scripting.flat_sensor` and `djpt.scripting.ray_loader`."""

from __future__ import annotations

from djpt.scripting.flat_sensor import FlatSensor
from djpt.scripting.ray_loader import RayDataLoader

__all__ = ["FlatSensor", "RayDataLoader"]
