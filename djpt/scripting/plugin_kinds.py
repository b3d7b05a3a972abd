"""Mitsuba's classes of kinds of plugins that djpt divides in another way, or doesn't have."""

from __future__ import annotations

from typing import Any

from djpt.errors import DjptError

__all__ = [
    "Medium",
    "PhaseFunction",
    "Volume",
    "register_medium",
    "register_phase",
    "register_phasefunction",
    "register_volume",
]


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


class PhaseFunction(Missing):
    """Phase functions of scattering media: none yet."""

    what = "phase functions"


class Volume(Missing):
    """Volumes of numbers: none yet."""

    what = "volumes"


def unsupported(what: str) -> DjptError:
    """The error of what needs scattering media."""
    return DjptError(
        f"djpt has no {what}: matter can absorb light (the key 'absorption' of dielectrics), not scatter it"
    )


def register_medium(name: str, constructor: Any) -> None:
    """Raise `DjptError`: there are no scattering media yet."""
    raise unsupported("media")


def register_phase(name: str, constructor: Any) -> None:
    """Raise `DjptError`: there are no phase functions yet."""
    raise unsupported("phase functions")


register_phasefunction = register_phase
"""A former name of `register_phase`."""


def register_volume(name: str, constructor: Any) -> None:
    """Raise `DjptError`: there are no volumes yet."""
    raise unsupported("volumes")
