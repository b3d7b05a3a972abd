"""Sensors: one file each, one registration line each."""

from djpt.description.registry import register_sensor
from djpt.sensors.base import Sensor
from djpt.sensors.perspective import Perspective

__all__ = ["Perspective", "Sensor"]

register_sensor("perspective", Perspective)
