"""Constant numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr

from djpt.core.numeric import as_array, as_number, describe
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float
from djpt.textures.base import Texture

__all__ = ["UniformTexture"]


class UniformTexture(Texture):
    """One number; numbers become this where a plugin asks for a scalar, such as a roughness.

    Parameters: `value` (required), `wavelength_min` and `wavelength_max` (nm; without effect on colours).
    """

    in_any_frame = True
    is_constant = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"value": ParamFlags.Differentiable}

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        value = props.raw("value")
        for key in ("wavelength_min", "wavelength_max"):
            props.float(key, 0.0)
        with props.naming("value"):
            self.value = as_float(as_number(value))
        self._allowed = Allowed()

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return Color3f(self.value)

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        return self.value

    def mean(self) -> Float:
        return self.value

    def max(self) -> float:
        return float(as_array(dr.detach(self.value)).max())

    def restrict(self, allowed: Allowed, where: str) -> None:
        allowed.require(as_array(dr.detach(self.value)), where)
        self._allowed = self._allowed.within(allowed)

    def check_parameter(self, name: str, value: Any) -> Any:
        if dr.is_array_v(value) and dr.is_jit_v(value) and dr.depth_v(value) == 1 and not dr.is_tensor_v(value):
            number = Float(value)
            if dr.width(number) != 1:
                raise ParameterError(f"must be one number, found {describe(value)}")
        else:
            number = Float(as_number(value))
        return self._allowed.checked(number)


register_texture("uniform", UniformTexture)
