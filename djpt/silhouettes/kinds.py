"""The kinds of shapes whose silhouettes are known."""

from __future__ import annotations

from typing import Any

from djpt.errors import SceneError
from djpt.shapes.questions import ShapeType
from djpt.silhouettes.base import Silhouette
from djpt.silhouettes.cylinder import CylinderSilhouette
from djpt.silhouettes.disk import DiskSilhouette
from djpt.silhouettes.mesh import MeshSilhouette
from djpt.silhouettes.rectangle import RectangleSilhouette
from djpt.silhouettes.sphere import SphereSilhouette

__all__ = ["silhouette_of", "types_of"]

KINDS: dict[ShapeType, type[Silhouette]] = {
    ShapeType.Mesh: MeshSilhouette,
    ShapeType.Rectangle: RectangleSilhouette,
    ShapeType.Cylinder: CylinderSilhouette,
    ShapeType.Disk: DiskSilhouette,
    ShapeType.Sphere: SphereSilhouette,
}


def kind_of(shape: Any) -> type[Silhouette] | None:
    """The class of a shape's silhouettes; None if they aren't known."""
    kind = KINDS.get(shape.shape_type())
    # Boxes are meshes by their number alone.
    return kind if (kind is MeshSilhouette) == shape.of_triangles else None


def types_of(shape: Any) -> int:
    """The `DiscontinuityFlags` of a shape's silhouettes; 0 if they aren't known."""
    kind = kind_of(shape)
    return 0 if kind is None else kind.types


def silhouette_of(shape: Any) -> Silhouette:
    """The silhouettes of a shape.

    Raises:
        SceneError: they aren't known.
    """
    kind = kind_of(shape)
    if kind is None:
        found = type(shape).__name__.lower()
        raise SceneError(
            f"{shape.id()}: the silhouettes of a '{found}' aren't known; "
            "those of meshes, rectangles, disks, cylinders and spheres are"
        )
    return kind(shape)
