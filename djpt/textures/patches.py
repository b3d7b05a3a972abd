"""Patches of surfaces: the parts within which no texture jumps. The edges between them move with their surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.lookup import is_one_of
from djpt.core.records import SurfaceInteraction3f
from djpt.description.registry import name_of
from djpt.jit.types import Bool, UInt32
from djpt.textures.base import Texture, textures_in
from djpt.textures.uv import UVTexture

__all__ = ["Patches", "adjoin", "have_patches", "seams"]

AROUND = {"sphere": (0,), "cylinder": (0,), "cone": (0,), "paraboloid": (0,), "torus": (0, 1), "disk": (1,)}
"""The texture coordinates, 0 for u and 1 for v, that are angles, by shapes: their values 0 and 1 are one place."""

CLOSE = 1e-3
"""How far hits that adjoin may be off each other's tangent planes, relative to 1 + the largest coordinate."""

PARTS = 3
"""The number of parts of a full turn, so that two different ones meet at its seam; nothing jumps between others."""


class Patches:
    """Numbers for the patches of some shapes.

    Args:
        shapes: The shapes, in the order of `SurfaceInteraction3f.shape_index`.
    """

    def __init__(self, shapes: Sequence[Any]) -> None:
        self._textures: dict[int, tuple[Texture, list[int]]] = {}
        self._turns: dict[int, list[int]] = {0: [], 1: []}
        for number, shape in enumerate(shapes):
            for texture in painted(shape):
                if texture.has_patches():
                    self._textures.setdefault(id(texture), (texture, []))[1].append(number)
            for axis in seams(shape):
                self._turns[axis].append(number)

    def __bool__(self) -> bool:
        """Whether any shape has more than one patch."""
        return bool(self._textures) or any(self._turns.values())

    def number(self, si: SurfaceInteraction3f) -> UInt32:
        """The number of the patch of a hit; 0 for shapes that have only one."""
        found = UInt32(0)
        for texture, shapes in self._textures.values():
            here = is_one_of(si.shape_index, shapes)
            found = dr.select(here, found * UInt32(0x85EBCA6B) + texture.patch(si) + 1, found)
        for axis, shapes in self._turns.items():
            if shapes:
                part = UInt32(dr.clip(si.uv[axis] * PARTS, 0, PARTS - 1))
                found = dr.select(is_one_of(si.shape_index, shapes), found * PARTS + part, found)
        return found

    def differ(self, a: SurfaceInteraction3f, b: SurfaceInteraction3f) -> Bool:
        """Whether hits on both sides of an edge lie next to each other, on different patches of one shape."""
        if not self:
            return Bool(False)
        return adjoin(a, b) & (a.shape_index == b.shape_index) & (self.number(a) != self.number(b))


def adjoin(a: SurfaceInteraction3f, b: SurfaceInteraction3f) -> Bool:
    """Whether two hits of rays next to each other lie next to each other, too, on one surface or where two meet.

    Along a surface that is seen at a grazing angle they may be far apart, but not off its tangent plane.
    """
    gap = a.p - b.p
    size = CLOSE * (1 + dr.maximum(dr.max(dr.abs(a.p)), dr.max(dr.abs(b.p))))
    near: Bool = (dr.abs(dr.dot(a.n, gap)) < size) & (dr.abs(dr.dot(b.n, gap)) < size)
    return near & a.is_valid() & b.is_valid()


def have_patches(shapes: Sequence[Any]) -> bool:
    """Whether any of some shapes has more than one patch."""
    return bool(Patches(shapes))


def painted(shape: Any) -> Iterator[Texture]:
    """The textures of a shape and its light."""
    for owner in (shape.bsdf(), shape.emitter()):
        if owner is not None:
            yield from textures_in(owner)


def seams(shape: Any, owner: Any = None) -> Iterator[int]:
    """The texture coordinates, 0 for u and 1 for v, along which some texture has a seam: it doesn't end as it begins.

    Args:
        shape: The shape.
        owner: Its BSDF or its emitter; None: both.
    """
    textures = list(painted(shape) if owner is None else textures_in(owner))
    for axis in AROUND.get(name_of(type(shape)) or "", ()):
        if any(isinstance(t, UVTexture) and t.is_spatially_varying() and not closes(t, axis) for t in textures):
            yield axis


def closes(texture: UVTexture, axis: int) -> bool:
    """Whether a texture repeats, a whole number of times, as a texture coordinate goes from 0 to 1."""
    turns = texture.to_uv.matrix[:2, axis]
    return getattr(texture, "wrap_mode", "repeat") == "repeat" and bool(np.allclose(turns, np.round(turns), atol=1e-5))
