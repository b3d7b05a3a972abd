"""Mitsuba's place of `djpt.mitsuba.flat_sensor` and `djpt.mitsuba.ray_loader`."""

from __future__ import annotations

from djpt.mitsuba.flat_sensor import FlatSensor
from djpt.mitsuba.ray_loader import RayDataLoader

__all__ = ["FlatSensor", "RayDataLoader"]
