"""Normals from a height field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import drjit as dr

from djpt.core.records import BSDFFlags, SurfaceInteraction3f, has_flag
from djpt.description.plugin import ParamFlags, Plugin
from djpt.description.properties import Allowed, Properties
from djpt.description.registry import register_bsdf
from djpt.errors import SceneError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Vector3f
from djpt.materials.perturbed import PerturbedBSDF

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["BumpMap"]


class BumpMap(PerturbedBSDF):
    """The nested BSDF about the normals that the surface would have if a texture's heights were added to it.

    With the heights h(u, v), n is the normal of p + scale h n: the tangents become dp/du + scale dh/du n and
    dp/dv + scale dh/dv n, where the change of n itself along the surface is left out.
    J. Blinn, "Simulation of Wrinkled Surfaces", SIGGRAPH 1978.

    Parameters: one nested texture under any key (read as a scalar and listed under `nested_texture`; a bitmap
    should have `raw` set), `scale` (default 1), and those of `PerturbedBSDF`. Textures without a
    gradient, such as bitmaps with the filter 'nearest', leave the surface flat.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {"scale": ParamFlags.Differentiable}
    children = ("nested_bsdf", "nested_texture")
    needs_uv: ClassVar[bool] = True
    """True: dp/du and dp/dv are read, even if the texture is constant."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        textures = [plugin for _, plugin in props.children("texture")]
        if len(textures) != 1:
            raise SceneError(f"{props.node}: 'bumpmap' takes one nested texture, found {len(textures)}")
        self.nested_texture = textures[0]
        self.nested_texture.used_by("bsdf")
        self.nested_texture.restrict(Allowed(), f"{props.node}: the heights")
        self.scale = as_float(props.float("scale", 1.0))

    def move_into(self, frame: Frame) -> None:
        """The heights are lengths."""
        self.move_nested(frame)
        self.nested_texture = frame.rescaled(self.nested_texture, 1)

    def has_jumps(self, interpolated: bool = False) -> bool:
        """True: the slopes of interpolated heights change from texel to texel."""
        return True

    def normal(self, si: SurfaceInteraction3f, active: Bool | bool) -> Vector3f:
        n = si.sh_frame.n
        slope = self.nested_texture.eval_1_grad(si, active) * self.scale
        dp_du = dr.fma(n, slope.x - dr.dot(n, si.dp_du), si.dp_du)
        dp_dv = dr.fma(n, slope.y - dr.dot(n, si.dp_dv), si.dp_dv)
        bumped = dr.cross(dp_du, dp_dv)
        return si.sh_frame.to_local(dr.select(dr.dot(si.n, bumped) < 0, -bumped, bumped))

    def tangent(self, si: SurfaceInteraction3f) -> Vector3f:
        # Mitsuba 3.9.1 takes dp/du in world space for one in the shading frame. Where the direction of `s`
        # shows, that is wrong; elsewhere it decides which direction a random number leads to.
        return super().tangent(si) if sees_tangent(self.nested_bsdf) else si.dp_du


def sees_tangent(plugin: Plugin) -> bool:
    """True if the BSDF changes when its frame is rotated about the normal."""
    if isinstance(plugin, PerturbedBSDF):
        return True
    children = [getattr(plugin, name) for name in plugin.children]
    flags = plugin.flags() if plugin.kind == "bsdf" else 0  # type: ignore[attr-defined]
    return has_flag(flags, BSDFFlags.Anisotropic) or any(
        sees_tangent(child) for child in children if isinstance(child, Plugin) and child.kind == "bsdf"
    )


register_bsdf("bumpmap", BumpMap)
