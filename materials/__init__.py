"""Scattering models: one BSDF per file, one registration line each."""

from __future__ import annotations

if __name__ != "djpt.materials":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.materials instead")
