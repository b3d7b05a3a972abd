"""The origin of a comparison: versions, the machine, and descriptions as text."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from djpt.jit.backends import variant
from djpt.version import __version__

__all__ = ["machine", "readable", "versions"]

LONGEST = 64
"""The numbers of an array that are written out; larger arrays are named by their shape."""

PACKAGES = ("drjit", "mitsuba", "numpy", "scipy", "flip-evaluator")


def versions() -> dict[str, str]:
    """The versions of djpt, Python and the packages that matter, where they are installed, and djpt's variant."""
    found = {"djpt": __version__, "Python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return {**found, "variant": variant()}


def machine() -> dict[str, str]:
    """The system, the processor and its number of threads."""
    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "threads": str(os.cpu_count() or 1),
    }


def processor() -> str:
    """The name of the processor, as far as the system tells."""
    if sys.platform == "linux":
        try:
            with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
                names = (line.partition(":")[2].strip() for line in file if line.startswith("model name"))
                return next(names, "unknown")
        except OSError:
            pass
    return platform.processor() or "unknown"


def readable(value: Any) -> Any:
    """A description as JSON can hold it: arrays as lists if they are small, everything else by its type's name."""
    if isinstance(value, Mapping):
        return {str(key): readable(inner) for key, inner in value.items()}
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "matrix"):
        return readable(value.matrix)
    if isinstance(value, (list, tuple)) and len(value) <= LONGEST:
        return [readable(inner) for inner in value]
    try:
        array = np.array(value)
    except (TypeError, ValueError, RuntimeError):
        return type(value).__name__
    if array.dtype.kind not in "fiub":
        return type(value).__name__
    if array.size > LONGEST:
        return f"array {array.shape} of {array.dtype}"
    return [readable(inner) for inner in array.tolist()] if array.ndim else readable(array.item())
