"""Variables: the quantities that an optimiser changes in place of parameters, so that these stay in their bounds."""

from __future__ import annotations

from math import inf
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.description.parameters import SceneParameters
from djpt.errors import ParameterError, near_miss
from djpt.jit.types import Float, UInt32

__all__ = ["Variable", "usual_bounds"]

KINDS = ("sigmoid", "projection", "free")
"""The ways of keeping parameters in bounds."""

ROUNDING = 1e-5
"""The tolerance by which a parameter may start outside its bounds."""

INSIDE = 1e-3
"""The share of the range by which a sigmoid's start is kept off its ends, where derivatives vanish."""


class Variable:
    """A parameter p of a scene as a function of a variable x.

    * `sigmoid`: ``p = low + (high - low) / (1 + exp(-x))``: never leaves its bounds, and moves slowly near them.
    * `projection`: p = x, and x is moved back into the bounds after each step.
    * `free`: p = x.

    Textures may be coarse at first: `refine` gives x more texels, and p is x upsampled by bilinear interpolation.

    Args:
        key: the parameter's name.
        value: its value, where the optimisation starts.
        bounds: (low, high).
        kind: one of `KINDS`.
        shrunk: for textures (H, W, C), the number of times that width and height are halved at first.

    Raises:
        ParameterError: Bounds or kind make no sense for this parameter, or it starts outside its bounds.
    """

    def __init__(self, key: str, value: Any, bounds: tuple[float, float], kind: str, shrunk: int = 0) -> None:
        if kind not in KINDS:
            raise ParameterError(f"{key}: unknown way of keeping bounds '{kind}'{near_miss(kind, KINDS)}")
        if not bounds[0] < bounds[1]:
            raise ParameterError(f"{key}: the lower bound must be below the upper one, found {bounds}")
        if not dr.is_array_v(value) or not dr.is_float_v(value):
            raise ParameterError(f"{key}: only arrays of numbers can be optimised, found {type(value).__name__}")
        self.key, self.bounds, self.kind = key, bounds, kind
        self.type = type(value)
        self._check_start(np.array(value, np.float64))
        self.shape: tuple[int, ...] = tuple(np.shape(np.array(value)))
        if shrunk and not (dr.is_tensor_v(value) and len(self.shape) == 3):
            raise ParameterError(f"{key}: only textures (height, width, channels) can start coarse")
        self.start = self.inverse(coarse(np.array(value, np.float64), shrunk))

    def _check_start(self, value: npt.NDArray[np.float64]) -> None:
        """Raise `ParameterError` if the parameter isn't in its bounds, or these aren't finite, as a sigmoid needs."""
        low, high = self.bounds
        if self.kind == "sigmoid" and not np.isfinite(high - low):
            raise ParameterError(
                f"{self.key}: a sigmoid needs finite bounds, found {self.bounds}: give 'bounds' for the parameter"
            )
        if self.kind != "free" and value.size and (value.min() < low - ROUNDING or value.max() > high + ROUNDING):
            raise ParameterError(
                f"{self.key}: starts at {value.min():g} .. {value.max():g}, outside its bounds {self.bounds}: "
                "give 'bounds' for the parameter, or keeping='free'"
            )

    @property
    def scale(self) -> float:
        """The scale of changes of x relative to those of other variables: the width of the bounds."""
        width = self.bounds[1] - self.bounds[0]
        return width if self.kind != "sigmoid" and np.isfinite(width) else 1.0

    def inverse(self, value: npt.NDArray[np.float64]) -> Any:
        """The variable that corresponds to a value of the parameter."""
        low, high = self.bounds
        if self.kind == "sigmoid":
            share = np.clip((value - low) / (high - low), INSIDE, 1 - INSIDE)
            value = np.log(share / (1 - share))
        elif self.kind == "projection":
            value = np.clip(value, low, high)
        return self.type(np.ascontiguousarray(value, np.float32))

    def parameter(self, x: Any) -> Any:
        """The parameter that corresponds to a variable, attached to it."""
        low, high = self.bounds
        p = low + (high - low) * dr.rcp(1 + dr.exp(-x)) if self.kind == "sigmoid" else x
        if dr.is_tensor_v(p) and tuple(p.shape) != self.shape:
            return magnified(p, self.shape)
        return p

    def projected(self, x: Any) -> Any:
        """The variable after a step, moved back into the bounds if it is the parameter itself."""
        return dr.clip(x, *self.bounds) if self.kind == "projection" else x

    def refined(self, x: Any) -> Any:
        """A coarse texture's variable with twice as many texels along each axis, at most as many as the parameter."""
        height, width, channels = x.shape
        shape = min(2 * height, self.shape[0]), min(2 * width, self.shape[1]), channels
        return self.type(np.array(magnified(dr.detach(x), shape), np.float32))

    def is_coarse(self, x: Any) -> bool:
        """True if the variable has fewer texels than the parameter."""
        return dr.is_tensor_v(x) and tuple(x.shape) != self.shape


def coarse(texels: npt.NDArray[np.float64], times: int) -> npt.NDArray[np.float64]:
    """A texture whose width and height are halved this many times, by averaging texels."""
    for _ in range(times):
        height, width = max(1, texels.shape[0] // 2), max(1, texels.shape[1] // 2)
        rows = np.array_split(texels, height, axis=0)
        texels = np.stack([[c.mean(axis=(0, 1)) for c in np.array_split(row, width, axis=1)] for row in rows])
    return texels


def magnified(texels: Any, shape: tuple[int, ...]) -> Any:
    """A texture with more texels, by bilinear interpolation between their centres, attached to the given one."""
    (height, width, channels), (rows, columns, _) = texels.shape, shape
    index = dr.arange(UInt32, rows * columns * channels)
    channel, pixel = index % channels, index // channels
    y, x = (coordinate(pixel // columns, rows, height), coordinate(pixel % columns, columns, width))
    result = dr.zeros(Float, rows * columns * channels)
    for row, share_y in y:
        for column, share_x in x:
            texel = (row * width + column) * channels + channel
            result += share_y * share_x * dr.gather(Float, texels.array, texel)
    return type(texels)(result, tuple(shape))


def coordinate(place: Any, fine: int, rough: int) -> list[tuple[Any, Any]]:
    """The two texels of a coarse axis about a texel of a fine one, each with its share."""
    position = dr.clip((Float(place) + 0.5) * (rough / fine) - 0.5, 0, rough - 1)
    lower = dr.minimum(UInt32(dr.floor(position)), max(rough - 2, 0))
    share = position - Float(lower)
    return [(lower, 1 - share), (dr.minimum(lower + 1, rough - 1), share)]


# ---- bounds that follow from the meaning of a parameter --------------------------------------


Bounds = tuple[float, float]

SHARE: Bounds = (0.0, 1.0)
POSITIVE: Bounds = (0.0, inf)
ANY: Bounds = (-inf, inf)

OF_KIND: dict[str, Bounds] = {
    "bsdf": SHARE,
    "emitter": POSITIVE,
    "medium": POSITIVE,
    "phase": SHARE,
    "shape": ANY,
    "sensor": ANY,
}
"""The bounds of parameters, by the kind of the innermost plugin among these that they belong to."""

BY_NAME: dict[tuple[str, str], Bounds] = {
    ("bsdf", "eta"): POSITIVE,
    ("bsdf", "k"): POSITIVE,
    ("bsdf", "to_uv"): ANY,
    ("emitter", "position"): ANY,
    ("emitter", "to_world"): ANY,
    ("medium", "albedo"): SHARE,
    ("medium", "to_world"): ANY,
    ("phase", "g"): (-0.999, 0.999),
}
"""Exceptions, by the kind and a part of the parameter's name."""


def usual_bounds(params: SceneParameters, key: str) -> Bounds:
    """The values that make sense for a parameter, (low, high), ends included.

    * of materials: 0 to 1, as for albedos and roughness; indices of refraction, `eta` and `k`: 0 to infinity;
    * of lights: 0 to infinity; of media likewise, but for their `albedo`, 0 to 1; `g` of a phase function: -0.999 to
      0.999;
    * of shapes and sensors, and transforms: unbounded.

    The values of a texture or a volume count as those of the plugin that uses it.

    Raises:
        ParameterError: There is no such parameter.
    """
    names = key.split(".")
    for plugin in params.owners(key):
        if plugin.kind in OF_KIND:
            exceptions = (BY_NAME.get((plugin.kind, name)) for name in names)
            return next((bounds for bounds in exceptions if bounds is not None), OF_KIND[plugin.kind])
    return ANY
