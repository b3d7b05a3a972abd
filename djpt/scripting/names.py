"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

__all__ = ["EXPORTS", "SUBMODULES"]

EXPORTS: dict[str, str] = {
    "djpt.scripting.records": "MediumInteraction3f MeshPtr Ray2f RayDifferential3f",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""
