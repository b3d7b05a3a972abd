"""A model as its file describes it: parts, materials, cameras and lights, before a stage is set for them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.errors import SceneError
from djpt.shapes.meshes.data import MeshData

__all__ = ["Camera", "Model", "Part"]

Matrix = NDArray[np.float64]

MOST_TRIANGLES = 2**27
"""The most triangles of a model, those of instances included."""
MOST_DISTANT = 1e30
"""The largest coordinate of a model, around which a stage still fits into single precision."""


@dataclass
class Part:
    """A mesh, its material, and the places where it stands."""

    name: str
    mesh: MeshData
    """In its own space."""
    bsdf: str
    """A key of `Model.nodes`."""
    places: list[Matrix]
    """From its own space to that of the model, (4, 4) each."""
    emission: dict[str, Any] | None = None
    """The texture of the light that it emits, or None."""
    interior: str | None = None
    """The medium inside, a key of `Model.nodes`, or None."""
    coordinates: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Sets of texture coordinates of the vertices, (V, 2) each. Textures name theirs by the entry ``uv_set``."""
    tints: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Colours of the vertices, (V, 1) or (V, 3), by which textures are multiplied that name them by ``tint``."""
    one_sided: bool = False
    """Whether the file asks to leave out what is seen from behind."""


@dataclass
class Camera:
    """A camera of the file; it looks along its own -z, with +y up."""

    name: str
    to_model: Matrix
    fov: float | None = None
    """The vertical angle of view in degrees; None for an orthographic camera."""
    height: float = 2.0
    """What an orthographic camera sees from bottom to top."""


@dataclass
class Model:
    """The contents of a file in the space of the file."""

    name: str
    up: str = "y"
    """The axis that points up: x, y or z, with a minus in front for down."""
    parts: list[Part] = field(default_factory=list)
    nodes: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Materials and media by name."""
    cameras: list[Camera] = field(default_factory=list)
    lights: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Emitters by name."""
    said: set[str] = field(default_factory=set)

    def say(self, text: str) -> None:
        """Warn, once for each text, of something in the file that can't be rendered, and of what is done instead."""
        if text not in self.said:
            self.said.add(text)
            warnings.warn(f"{self.name}: {text}", stacklevel=3)

    def bounds(self) -> tuple[Matrix, Matrix]:
        """The smallest and the largest coordinates of all parts, (3,) each.

        Raises:
            SceneError: there is nothing to see, or it is too far away.
        """
        corners = []
        triangles = 0
        for part in self.parts:
            triangles += len(part.mesh.indices) * len(part.places)
            with np.errstate(all="ignore"):
                used = part.mesh.positions[np.isfinite(part.mesh.positions).all(axis=1)]
                if not len(used):
                    continue
                low, high = used.min(axis=0), used.max(axis=0)
                box = np.array(
                    [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
                )
                for place in part.places:
                    # Boxes of turned boxes are too large; few points can be turned one by one.
                    points = used if len(used) <= 100_000 and len(part.places) <= 4 else box
                    moved = points @ place[:3, :3].T + place[:3, 3]
                    corners += [moved.min(axis=0), moved.max(axis=0)]
        if triangles > MOST_TRIANGLES:
            raise SceneError(f"{self.name}: has {triangles} triangles, instances included; at most {MOST_TRIANGLES}")
        found = np.array([corner for corner in corners if np.isfinite(corner).all()])
        if not len(found):
            raise SceneError(f"{self.name}: no triangles: there is nothing to see")
        low, high = found.min(axis=0), found.max(axis=0)
        reach = float(np.abs([low, high]).max())
        if reach > MOST_DISTANT:
            raise SceneError(f"{self.name}: coordinates reach {reach:.3g}; at most {MOST_DISTANT:g}")
        return low, high
