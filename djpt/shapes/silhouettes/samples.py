"""The record of a point on a silhouette, with a direction that grazes the surface there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.records import RAY_EPSILON, DiscontinuityFlags, PositionSample3f, Ray3f
from djpt.core.records.record import no_wavelengths
from djpt.dispatch.family import NONE, SCRIPT_PLUGINS, Pointer
from djpt.jit.types import Bool, Float, UInt32, Vector3f

__all__ = ["SilhouetteSample3f"]

NORMAL_OFFSET = RAY_EPSILON / 80
"""The offset of rays along the normal, relative to 1 + the largest coordinate (Mitsuba's value)."""


class SilhouetteSample3f(PositionSample3f):
    """A segment of a silhouette: ``SilhouetteSample3f()``, ``SilhouetteSample3f(ss)``, ``SilhouetteSample3f(ps)``.

    `n` is perpendicular to `d` and to the silhouette and points away from the shape; `uv` are texture coordinates, or
    the barycentric weights of a mesh's triangle; `pdf` is per unit length of the curve and unit solid angle, or, of
    smooth surfaces, per unit area and unit angle.
    """

    title = "SilhouetteSample"

    discontinuity_type: UInt32
    """The one `DiscontinuityFlags` that the point belongs to; `Empty` if there is none."""
    d: Vector3f
    """The direction of the segment: away from the viewer."""
    silhouette_d: Vector3f
    """The unit direction of the silhouette."""
    prim_index: UInt32
    """The triangle of a mesh; else 0."""
    scene_index: UInt32
    """Index into `Scene.silhouette_shapes`, if the scene was asked."""
    flags: UInt32
    """The `DiscontinuityFlags` that were asked for."""
    projection_index: UInt32
    """The edge 0, 1 or 2 of a mesh's triangle; else 0."""
    number: UInt32
    """The shape, as pointers number it."""
    foreshortening: Float
    """The sine between `d` and an edge; the normal curvature along `d` of a smooth surface."""
    offset: Float
    """The offset of rays along `d`, relative to 1 + the largest coordinate, where points aren't exact."""
    gap: Float
    """How far rays keep clear of the silhouette where they meet another surface than it belongs to, which is close."""
    sight: Float
    """The distance of the viewer; 0 if it isn't asked for."""
    strip: Float
    """The width of the strip inside the silhouette in which the patches of textures aren't told apart."""
    unbent: Bool
    """Whether the surface is dark where its normal points away from the viewer; else the normal is bent."""

    def __init__(self, other: Any = None, **fields: Any) -> None:
        shape = fields.pop("shape", None)
        super().__init__(other, **fields)
        if shape is not None:
            self.shape = shape

    def default(self, name: str) -> Any:
        return UInt32(NONE) if name == "number" else super().default(name)

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: no silhouette."""
        self.fill_with_zeros(size)
        self.number = dr.full(UInt32, NONE, size)

    @property
    def shape(self) -> Any:
        """The shape that the point lies on, or none: a `djpt.shapes.pointer.ShapePtr`."""
        return Pointer.of_kind("shape").holding(index=self.number, scene_ref={SCRIPT_PLUGINS.of("shape"): ()})

    @shape.setter
    def shape(self, shape: Any) -> None:
        if isinstance(shape, Pointer):
            numbers = [UInt32(SCRIPT_PLUGINS.number(plugin)) for plugin in shape.plugins]
            number = UInt32(NONE)
            for index, value in enumerate(numbers):
                number = dr.select(shape.index == index, value, number)
            self.number = number
        else:
            self.number = UInt32(NONE if shape is None else SCRIPT_PLUGINS.number(shape))

    def shown(self) -> Sequence[str]:
        return ["shape" if name == "number" else name for name in super().shown()]

    def text(self, name: str) -> str:
        if name == "shape" and "number" not in self.__dict__:
            return "[0x0]"
        return super().text(name)

    def is_valid(self) -> Bool:
        """True where there is a silhouette."""
        return self.discontinuity_type != int(DiscontinuityFlags.Empty)

    def toward_viewer(self) -> SilhouetteSample3f:
        """The same point, from which rays start towards the viewer."""
        back = SilhouetteSample3f(self)
        back.d, back.offset = -self.d, dr.abs(self.offset)
        return back

    def spawn_ray(self, wavelengths: Any = None) -> Ray3f:
        """The ray along `d` that just misses the shape.

        It starts off the surface, by `offset` along `d`, and by `gap` and a little more along `n`.
        """
        no_wavelengths(wavelengths)
        size = 1 + dr.max(dr.abs(self.p))
        aside = dr.fma(size, NORMAL_OFFSET, self.gap)
        return Ray3f(self.p + (self.d * (size * self.offset) + self.n * aside), self.d)
