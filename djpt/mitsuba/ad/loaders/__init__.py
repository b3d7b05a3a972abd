"""Mitsuba's package of loaders, which give an optimisation batches of pixels."""

from __future__ import annotations

from djpt.mitsuba.ad.loaders import ray_loader as ray_loader
from djpt.mitsuba.ad.loaders.ray_loader import FlatSensor, RayDataLoader

__all__ = ["FlatSensor", "RayDataLoader", "ray_loader"]
