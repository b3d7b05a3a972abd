"""All built-in scenes at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from djpt import scenes

__all__ = ["SCENES"]

SCENES: dict[str, Callable[[], dict[str, Any]]] = {name: getattr(scenes, name) for name in scenes.NAMES}
"""The functions of the built-in scenes by name. Each call makes a new dict."""
