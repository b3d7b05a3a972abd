"""Parameters of a mesh that somebody has edited, read back as rows on the host."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import ParameterError, SceneError
from djpt.shapes.meshes.cleaning import check_indices

__all__ = ["Edits"]


@dataclass
class Edits:
    """The parameters of a mesh: those that have changed must fit the mesh, the others follow its size.

    Args:
        node: the mesh's name in messages.
        parameter: gives the flat array of a parameter by the parameter's name.
        changed: the names of the parameters that were edited.
    """

    node: str
    parameter: Callable[[str], Any]
    changed: Set[str]

    def rows(self, name: str, width: int) -> NDArray[Any]:
        """Read a parameter as rows, (N, `width`); raises `ParameterError` if its numbers don't make whole ones."""
        flat = np.array(dr.detach(self.parameter(name)))
        if flat.size % width:
            raise ParameterError(f"{self.node}.{name}: {flat.size} numbers don't make rows of {width}")
        return flat.reshape(-1, width)

    def faces(self, old: NDArray[np.uint32], vertices: int) -> NDArray[np.uint32]:
        """The corners of all triangles, (F, 3): `old` ones unless they were edited.

        Raises:
            ParameterError: no triangle, or an index that isn't less than the number of `vertices`.
        """
        indices = self.rows("faces", 3).astype(np.uint32) if "faces" in self.changed else old
        if not len(indices):
            raise ParameterError(f"{self.node}.faces: a mesh needs at least one triangle")
        try:
            check_indices(indices, vertices, f"{self.node}.faces")
        except SceneError as error:
            raise ParameterError(str(error)) from None
        return indices

    def fitting_rows(self, name: str, width: int, count: int) -> NDArray[np.float32] | None:
        """Read the rows, (`count`, `width`), that belong to vertices or faces; None if the parameter is empty.

        They are zeros if only the number of vertices or faces has changed; normals become zeros in silence, since they
        are computed anew.

        Raises:
            ParameterError: the parameter was edited, and has another number of rows.
        """
        value = self.rows(name, width)
        if not len(value):
            return None
        if len(value) != count:
            if name in self.changed:
                raise ParameterError(f"{self.node}.{name}: must be {count} rows of {width}, found {len(value)}")
            if name != "vertex_normals":
                warnings.warn(f"{self.node}.{name}: the size of the mesh has changed; set to zero", stacklevel=2)
            value = np.zeros((count, width), np.float32)
        return value
