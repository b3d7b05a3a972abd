"""Where the textures of a shape jump."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.textures.base import textures_in
from djpt.textures.mesh_attribute import MeshAttribute
from djpt.textures.uv import UVTexture

if TYPE_CHECKING:
    from djpt.shapes.mesh import Mesh

__all__ = ["AT_SEAMS", "EVERYWHERE", "NOWHERE", "jumps_of_textures"]

NOWHERE, AT_SEAMS, EVERYWHERE = "nowhere", "at seams", "everywhere"
"""The edges of a mesh between whose triangles a texture jumps: where there are several vertices at one place; all."""


def jumps_of_textures(mesh: Mesh) -> str:
    """The edges of a mesh at which its textures may jump.

    Texture coordinates, and the attributes of vertices, are continuous but for seams. Without texture coordinates a
    texture begins anew in each triangle, and the attributes of faces are colours of their own.
    """
    found = NOWHERE
    for owner in (mesh.bsdf(), mesh.emitter()):
        for texture in () if owner is None else textures_in(owner):
            if isinstance(texture, MeshAttribute):
                torn = texture.name.startswith("face_")
            elif isinstance(texture, UVTexture) and texture.is_spatially_varying():
                torn = not mesh.has_vertex_texcoords()
            else:
                continue
            if torn:
                return EVERYWHERE
            found = AT_SEAMS
    return found
