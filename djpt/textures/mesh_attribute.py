"""Colours and numbers that a mesh carries at its vertices or faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.color import LUMINANCE
from djpt.core.numeric import as_array
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_texture
from djpt.errors import SceneError, near_miss
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Color3f, Float, Vector2f
from djpt.textures.base import Texture

__all__ = ["MeshAttribute"]


class MeshAttribute(Texture):
    """An attribute of the mesh that the texture is used on: interpolated over vertices, constant on faces.

    Parameters: `name` (required; begins with ``vertex_`` or ``face_``), `scale` (default 1, multiplies).
    Attributes have one channel or three. All shapes with such a texture must be meshes that carry the
    attribute. Emitters can't use it: a point that is sampled on a light doesn't know its triangle.
    Gradients reach `scale`, but not the mesh.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {"scale": ParamFlags.Differentiable}
    statics = ("name", "node")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.node = props.node
        self.name = props.string("name")
        if not self.name.startswith(("vertex_", "face_")):
            raise props.error("name", f"must begin with 'vertex_' or 'face_', found '{self.name}'")
        self.scale = as_float(props.float("scale", 1.0))
        self._allowed = Allowed()

    # ---- on the host -------------------------------------------------------------------

    def mean(self) -> Float:
        """A guess, since the texture doesn't know the mesh: half of `scale`. It only decides on probabilities."""
        return 0.5 * self.scale

    def used_by(self, kind: str) -> None:
        if kind == "emitter":
            raise SceneError(f"{self.node}: a mesh attribute can't be the colour of a light")

    def restrict(self, allowed: Allowed, where: str) -> None:
        # The numbers are the mesh's: they are looked at when the scene is known.
        self._allowed = self._allowed.within(allowed)

    def require_on(self, shape: Any) -> None:
        attributes = getattr(shape, "attributes", None)
        if not shape.of_triangles or attributes is None:
            raise SceneError(f"{self.node}: '{shape.id()}' isn't a mesh, and has no attribute '{self.name}'")
        if self.name not in attributes:
            hint = near_miss(self.name, attributes)
            raise SceneError(f"{self.node}: the mesh '{shape.id()}' has no attribute '{self.name}'{hint}")
        if not recording():
            numbers = np.asarray(attributes[self.name][0]) * np.float32(as_array(dr.detach(self.scale)))
            self._allowed.require(numbers, f"{shape.id()}: '{self.name}'")

    # ---- in kernels --------------------------------------------------------------------

    def eval(self, si: Any, active: Bool | bool = True) -> Color3f:
        return Color3f(self._value(si, active))

    def eval_1(self, si: Any, active: Bool | bool = True) -> Float:
        value = self._value(si, active)
        if dr.depth_v(value) == 1:
            return value
        r, g, b = LUMINANCE
        return value.x * r + value.y * g + value.z * b

    def eval_1_grad(self, si: Any, active: Bool | bool = True) -> Vector2f:
        raise SceneError(f"{self.node}: a mesh attribute has no gradient with respect to uv, so it can't be a bump map")

    def _value(self, si: Any, active: Bool | bool) -> Any:
        return si.scene.geometry.attribute(self.name, si.face, si.prim_uv, active) * self.scale


register_texture("mesh_attribute", MeshAttribute)
