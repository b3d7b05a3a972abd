"""The arguments that the verbs of rendering share: integrators, seeds, counts."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.numeric import whole
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.integrators.path import Path
from djpt.jit.frozen import recording
from djpt.jit.types import UInt32
from djpt.rendering.schedules.job import MAX_SAMPLES
from djpt.samplers.seeds import Seed
from djpt.scene.arguments import require_scene
from djpt.scene.scene import Scene

__all__ = ["check_count", "check_seed", "find_integrator"]


def find_integrator(scene: Scene, integrator: Any) -> Integrator:
    """The integrator that was asked for, or the scene's, or else `path`."""
    require_scene(scene)
    if integrator is None:
        integrator = scene.integrator() or Path(Properties("path", "integrator", {}))
    if not isinstance(integrator, Integrator):
        hint = "; load it with djpt.load_dict first" if isinstance(integrator, dict) else ""
        raise RenderError(f"'integrator' must be an integrator plugin, found {type(integrator).__name__}{hint}")
    return integrator


def check_count(name: str, value: Any) -> int:
    """The value as an int; raises `RenderError` unless it is whole, not negative and fits into 32 bits."""
    count = whole(value)
    if count is None or count < 0:
        raise RenderError(f"'{name}' must be a whole number, 1 or more (0 = default), found {value!r}")
    if count >= MAX_SAMPLES:
        raise RenderError(f"'{name}' must be below 2^32, found {value!r}")
    return count


def check_seed(name: str, value: Any) -> Seed:
    """The value as an int; raises `RenderError` unless it is whole and fits into 32 bits.

    An array stays one where `dr.freeze` records: the next call of the frozen function may bring another value.
    """
    if recording() and dr.is_jit_v(value) and dr.is_integral_v(value) and dr.depth_v(value) == 1:
        if dr.width(value) != 1:
            raise RenderError(f"'{name}' must be one whole number, found {dr.width(value)}")
        return UInt32(value)
    seed = whole(value)
    if seed is None or not 0 <= seed < 2**32:
        raise RenderError(f"'{name}' must be a whole number with 0 <= {name} < 2^32, found {value!r}")
    return seed
