"""Scenes of what there is in memory: meshes of trimesh, Open3D and pyvista, arrays, paths, scenes."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from djpt.core.numeric import describe
from djpt.description.files import Document
from djpt.errors import SceneError
from djpt.images.srgb import decoded
from djpt.models.formats import STAGE, is_model, read_model

__all__ = ["description_of", "scene_of"]

SHAPE_STAGE = ("up", "stage")
"""Parameters of `djpt.models.stage.around`."""


def scene_of(x: Any, **parameters: Any) -> Any:
    """The scene that shows `x`.

    Args:
        x: a `djpt.Scene`, returned as it is; a description of a scene or of a shape; the path of an XML file or a
            model; a mesh or a scene of trimesh; a mesh of Open3D (legacy or tensor) or pyvista; a `djpt.Mesh`; a pair
            of vertices (V, 3) and triangles (F, 3); or an object with `vertices` and `faces`.
        parameters: of models and meshes: `up`, `camera`, `stage` and `cull`, see `djpt.models.formats.read_model`.

    Raises:
        SceneError: it is something else, or can't be rendered.
        FileError: a file can't be read.
    """
    from djpt.description.loader import load_dict
    from djpt.scene.scene import Scene

    return x if isinstance(x, Scene) else load_dict(description_of(x, **parameters))


def description_of(x: Any, **parameters: Any) -> dict[str, Any]:
    """The description of the scene that shows `x`; arguments and errors are those of `scene_of`."""
    if isinstance(x, (str, os.PathLike)):
        if is_model(x):
            return read_model(x, **parameters)
        from djpt.description.xml.reading import read_file

        return read_file(x, **parameters)
    if isinstance(x, Mapping) and x.get("type") == "scene":
        if parameters:
            raise SceneError(f"scene_of: a scene has its own camera and lights; '{next(iter(parameters))}' has no use")
        return x if isinstance(x, Document) else dict(x)
    from djpt.models.stage import around, staged

    possible = SHAPE_STAGE if isinstance(x, Mapping) else STAGE
    unknown = [name for name in parameters if name not in possible]
    if unknown:
        raise SceneError(f"scene_of: unknown parameter '{unknown[0]}' (possible: {', '.join(possible)})")
    if isinstance(x, Mapping):
        return around(x, **parameters)
    return staged(model_of(x), **parameters)


def model_of(x: Any) -> Any:
    """The model of an object that holds triangles."""
    from djpt.models.meshes import of_arrays, of_trimesh

    package = type(x).__module__.partition(".")[0]
    if package == "trimesh":
        return of_trimesh(x, "trimesh")
    if isinstance(x, (tuple, list)) and len(x) == 2:
        return of_arrays(x[0], x[1], "mesh")
    found = of_open3d(x) or of_pyvista(x)
    if found is not None:
        return of_arrays(
            found["positions"], found["faces"], type(x).__name__, found.get("colors"), found.get("normals")
        )
    data = getattr(x, "data", None)
    if package == "djpt" and callable(data):
        mesh = data()
        return of_arrays(mesh.positions, mesh.indices, x.id() or "mesh")
    vertices, faces = getattr(x, "vertices", None), getattr(x, "faces", None)
    if vertices is not None and faces is not None:
        return of_arrays(np.asarray(vertices), np.asarray(faces), type(x).__name__)
    raise SceneError(
        f"scene_of: can't show {describe(x)}; possible: a path, a scene or its description, a mesh of trimesh, Open3D "
        "or pyvista, or a pair of vertices (V, 3) and triangles (F, 3)"
    )


def of_open3d(x: Any) -> dict[str, Any] | None:
    """The arrays of a mesh of Open3D, legacy or tensor; None for others."""
    if hasattr(x, "vertices") and hasattr(x, "triangles"):
        found = {
            "colors": np.asarray(getattr(x, "vertex_colors", ())),
            "normals": np.asarray(getattr(x, "vertex_normals", ())),
        }
        return {"positions": np.asarray(x.vertices), "faces": np.asarray(x.triangles)} | used(found)
    if hasattr(x, "vertex") and hasattr(x, "triangle"):
        found = {name: x.vertex[name].numpy() for name in ("colors", "normals") if name in x.vertex}
        return {"positions": x.vertex["positions"].numpy(), "faces": x.triangle["indices"].numpy()} | used(found)
    return None


def of_pyvista(x: Any) -> dict[str, Any] | None:
    """The arrays of a data set of pyvista; None for others."""
    if not hasattr(x, "extract_surface"):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of defaults that will change
        surface = x.extract_surface().triangulate()
    # Not the normals, which shared corners of a box have, too; pyvista's plots are flat by default.
    data = getattr(surface, "point_data", {})
    colors = next((data[key] for key in ("RGB", "RGBA") if key in data), ())
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    return {"positions": np.asarray(surface.points), "faces": faces} | used({"colors": np.asarray(colors)})


def used(found: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays that have rows; colours, bytes or numbers in [0, 1] of sRGB, as linear ones."""
    result = {name: rows for name, rows in found.items() if len(rows)}
    if "colors" in result:
        scale = 255 if result["colors"].dtype == np.uint8 else 1
        result["colors"] = decoded(np.clip(result["colors"][:, :3] / scale, 0, 1))
    return result
