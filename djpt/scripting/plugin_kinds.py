"""Mitsuba's classes of kinds of plugins that djpt divides in another way, or doesn't have."""

from __future__ import annotations

import abc
from typing import Any

from djpt.description.registry import register_phase
from djpt.emitters.base import Emitter
from djpt.errors import DjptError
from djpt.sensors.base import Sensor

__all__ = ["Endpoint", "Medium", "register_phasefunction"]

register_phasefunction = register_phase
"""A former name of `register_phase`."""


class Endpoint(abc.ABC):  # noqa: B024 - classes are registered, none is derived from it
    """What both ends of a path are: emitters and sensors are instances of it."""


Endpoint.register(Emitter)
Endpoint.register(Sensor)


class Missing:
    """A kind of plugin that djpt doesn't have: its class can be named and tested for, not made or derived from."""

    what: str

    def __init__(self, *args: Any, **options: Any) -> None:
        raise unsupported(self.what)

    def __init_subclass__(cls, **options: Any) -> None:
        if "what" not in vars(cls):
            raise unsupported(cls.what)
        super().__init_subclass__(**options)


class Medium(Missing):
    """Scattering media: none yet."""

    what = "media"


def unsupported(what: str) -> DjptError:
    """The error of what needs scattering media."""
    return DjptError(
        f"djpt has no {what}: matter can absorb light (the key 'absorption' of dielectrics), not scatter it"
    )
