"""Triangle meshes on the host: their data, readers, vertex normals, cleaning."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.shapes.meshes.data import MeshData as MeshData
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
