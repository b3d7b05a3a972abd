"""Colours and numbers that a mesh carries at its vertices or faces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np

from djpt.description.numeric import as_array, is_readable
from djpt.description.plugin import ParamFlags, Plugin
from djpt.description.properties import Properties
from djpt.errors import SceneError
from djpt.geometry.bvh.records import LEAF, PORTAL, WORDS
from djpt.geometry.bvh.traversal import NONE
from djpt.images.color import LUMINANCE
from djpt.kernels import as_float
from djpt.textures.allowed import Allowed
from djpt.textures.base import Texture
from djpt.types import Bool, Color3f, Float, UInt32, Vector2f

if TYPE_CHECKING:
    from djpt.scene import Scene
    from djpt.shapes import Shape

__all__ = ["MeshAttribute", "check_attributes"]


class MeshAttribute(Texture):
    """An attribute of the mesh that the texture is used on: interpolated over vertices, constant on faces.

    Parameters: `name` (required; begins with ``vertex_`` or ``face_``), `scale` (default 1, multiplies).
    Attributes have one channel or three. All shapes with such a texture must be meshes that carry the
    attribute. Emitters can't use it: a point that is sampled on a light doesn't know its triangle.
    Gradients reach `scale`, but not the mesh.
    """

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

    def require_on(self, shape: Shape) -> None:
        """Raise `SceneError` if the texture can't be used on `shape`."""
        attributes = getattr(shape, "attributes", None)
        if not shape.of_triangles or attributes is None:
            raise SceneError(f"{self.node}: '{shape.id}' isn't a mesh, and has no attribute '{self.name}'")
        if self.name not in attributes:
            found = ", ".join(attributes) or "none"
            raise SceneError(f"{self.node}: the mesh '{shape.id}' has no attribute '{self.name}'; found: {found}")
        if is_readable():
            numbers = np.asarray(attributes[self.name][0]) * np.float32(as_array(dr.detach(self.scale)))
            self._allowed.require(numbers, f"{shape.id}: '{self.name}'")

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
        raise SceneError(f"{self.node}: a mesh attribute has no gradient by uv, so it can't be a bump map")

    def _value(self, si: Any, active: Bool | bool) -> Any:
        geometry = si.scene.geometry
        record = geometry.record_of(si.face)
        active = active & (record != NONE)
        words = geometry.triangles.records.words
        kind, number = (dr.gather(UInt32, words, record * WORDS + k, active) for k in (12, 13))
        # Records of nodes and of other shapes have something else there.
        face = dr.select(active & ((kind & (LEAF | PORTAL)) == LEAF), number, 0)
        return geometry.triangles.meshes.attribute(self.name, face, si.prim_uv.x, si.prim_uv.y) * self.scale


def check_attributes(scene: Scene) -> None:
    """Does every shape carry the attributes that its textures ask for, with values in their ranges?

    Raises:
        SceneError: a shape isn't a mesh, lacks an attribute, or its values can't be used.
    """
    for shape in scene.geometry.contents.shapes:
        if shape.bsdf is not None:
            for texture in attributes_in(shape.bsdf):
                texture.require_on(shape)


def attributes_in(plugin: Plugin) -> Iterator[MeshAttribute]:
    """All textures of this kind below a plugin."""
    if isinstance(plugin, MeshAttribute):
        yield plugin
    for name in plugin.children:
        child = getattr(plugin, name)
        if isinstance(child, Plugin):
            yield from attributes_in(child)
