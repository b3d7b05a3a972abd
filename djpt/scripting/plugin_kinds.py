"""Mitsuba's classes of kinds of plugins that djpt divides in another way."""

from __future__ import annotations

import abc

from djpt.description.registry import register_phase
from djpt.emitters.base import Emitter
from djpt.sensors.base import Sensor

__all__ = ["Endpoint", "register_phasefunction"]

register_phasefunction = register_phase
"""A former name of `register_phase`."""


class Endpoint(abc.ABC):  # noqa: B024 - classes are registered, none is derived from it
    """What both ends of a path are: emitters and sensors are instances of it."""


Endpoint.register(Emitter)
Endpoint.register(Sensor)
