"""Built-in scenes, as functions that return dicts."""

from __future__ import annotations

if __name__ != "djpt.scenes":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.scenes instead")
