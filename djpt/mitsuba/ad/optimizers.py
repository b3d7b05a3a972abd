"""The optimisers of `drjit.opt`, which can be given all parameters of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
from drjit import opt
from drjit.opt import GradScaler, Optimizer

from djpt.description.parameters import SceneParameters

__all__ = ["SGD", "Adam", "AdamW", "GradScaler", "Optimizer", "RMSProp"]


class OfScenes:
    """An optimiser that takes what `traverse` returned, and leaves out what isn't numbers with a derivative."""

    def _filter(self, params: Mapping[str, Any], /) -> Mapping[str, Any]:
        if not isinstance(params, SceneParameters):
            return params
        taken = {key: value for key, value in params.items() if params.flags(key).differentiable}
        return {key: value for key, value in taken.items() if dr.is_diff_v(value) and dr.is_float_v(value)}


class Adam(OfScenes, opt.Adam):
    """`drjit.opt.Adam`."""


class AdamW(OfScenes, opt.AdamW):
    """`drjit.opt.AdamW`."""


class RMSProp(OfScenes, opt.RMSProp):
    """`drjit.opt.RMSProp`."""


class SGD(OfScenes, opt.SGD):
    """`drjit.opt.SGD`."""
