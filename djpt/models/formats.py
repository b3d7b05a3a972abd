"""Formats of model files by suffix."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from djpt.core.files import as_path, require_regular
from djpt.description.files import Document
from djpt.errors import FileError, SceneError, near_miss

__all__ = ["SUFFIXES", "is_model", "load_file", "read_model"]

USD = (".usd", ".usda", ".usdc", ".usdz")
SUFFIXES = (".glb", ".gltf", ".obj", ".stl", ".off", ".3mf", ".ply", *USD)
"""The suffixes of model files."""

STAGE = ("up", "camera", "stage", "cull")
"""Parameters of `djpt.models.stage.staged`."""


def is_model(path: Any) -> bool:
    """True if a path has the suffix of a model file."""
    return isinstance(path, (str, os.PathLike)) and os.fspath(path).lower().endswith(SUFFIXES)


def reader_of(suffix: str) -> Callable[..., Any]:
    """The reader of a format: it takes the file's contents, its folder, its name and parameters of its own."""
    if suffix in (".glb", ".gltf"):
        from djpt.models.gltf import read_gltf

        return read_gltf
    if suffix in USD:
        from djpt.models.usd import read_usd

        return read_usd
    from djpt.models.meshes import read_mesh

    return read_mesh


def read_model(path: str | os.PathLike[str], root: str | os.PathLike[str] | None = None, **parameters: Any) -> Document:
    """Read a model file as the description of a scene.

    Args:
        path: the file; the suffix tells the format.
        root: the folder outside of which no file is read; default: that of the file.
        parameters: `up` (the axis that points up), `camera` (the number of the file's camera, or None for one that
            frames the model), `stage` (whether there is a sky and a ground; default: where the file has no lights),
            `cull` (whether what is seen from behind is left out where the file asks for it; default: no), and
            those of the format's reader. Texts, as the command line gives them, are converted.

    Raises:
        FileError: the file can't be read.
        SceneError: it is damaged, or there is no such parameter.
    """
    from djpt.models.folder import Folder
    from djpt.models.stage import staged

    source = as_path(path)
    require_regular(source)
    suffix = source.suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(f"'{source}' isn't a model; the suffixes of models are {', '.join(SUFFIXES)}")
    read = reader_of(suffix)
    own = [name for name, p in inspect.signature(read).parameters.items() if p.kind is p.KEYWORD_ONLY]
    unknown = [name for name in parameters if name not in (*own, *STAGE)]
    if unknown:
        raise SceneError(f"{source.name}: unknown parameter '{unknown[0]}'{near_miss(unknown[0], [*own, *STAGE])}")
    given = converted(parameters, source.name)
    folder = Folder(source.parent if root is None else root)
    if not folder.contains(source):
        raise FileError(f"'{source}' isn't in '{folder.path}', which a model may not leave")
    inner = Folder(source.parent, folder.path)
    data = inner.read(source.name)
    try:
        model = read(data, inner, source.name, **{key: given[key] for key in given if key in own})
        description = staged(model, **{key: given[key] for key in given if key in STAGE})
    except (OverflowError, RecursionError) as error:
        raise SceneError(f"{source.name}: numbers out of range: {error}") from None
    except MemoryError:
        raise SceneError(f"{source.name}: doesn't fit into memory") from None
    # Errors name the file, whose parts have no lines.
    nested = [f"{key}.shape" for key in description if key.startswith("group_")]
    return Document(description, source.stem, dict.fromkeys(("", *description, *nested), f"{source}:1"))


def converted(parameters: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Parameters with texts as the values that they stand for."""
    result = dict(parameters)
    for key, value in parameters.items():
        if not isinstance(value, str) or key in ("up", "variant"):
            continue
        words = {"none": None, "true": True, "false": False}
        if value.lower() in words:
            result[key] = words[value.lower()]
            continue
        try:
            result[key] = float(value) if key == "time" else int(value)
        except ValueError:
            raise SceneError(f"{name}: '{key}' can't be '{value}'") from None
    for key, kinds, what in (
        ("time", (int, float), "a number of seconds"),
        ("animation", (int,), "the number of an animation"),
        ("texture_size", (int,), "a number of pixels"),
    ):
        value = result.get(key)
        if value is None and key in ("time",):
            continue
        if key in result and (isinstance(value, bool) or not isinstance(value, kinds)):
            raise SceneError(f"{name}: '{key}' must be {what}, found {value!r}")
    if "texture_size" in result and result["texture_size"] < 1:
        raise SceneError(f"{name}: 'texture_size' must be at least 1")
    return result


def load_file(
    path: str | os.PathLike[str],
    parallel: bool = True,
    optimize: bool = True,
    *,
    trusted: bool = True,
    root: str | os.PathLike[str] | None = None,
    **parameters: Any,
) -> Any:
    """Build a scene from a file: Mitsuba's XML, or a model (glTF, OBJ, STL, OFF, 3MF, PLY, USD).

    Of an XML file the outermost tag may be any plugin. File names in it are looked up in its own directory first, then
    in the working directory. A model gets a camera that frames it, unless it has one, and a sky and a ground where
    it has no lights.

    Args:
        path: the file; the suffix tells the format.
        parallel: accepted for Mitsuba's signature, no effect.
        optimize: false for lights that are numbered in the file's order: see `djpt.load_dict`.
        trusted: false for a scene of a stranger: it may read files in `root` only, whatever names, links or
            includes it has. Models never read others. See SECURITY.md for what else is promised.
        root: that directory; default: the one of the file.
        parameters: XML: values for the ``$name`` of the file: strings, numbers, booleans. They win over the
            file's ``<default>``. Models: see `djpt.models.formats.read_model`.

    Returns:
        A `djpt.Scene` if the outermost tag is ``<scene>``, or of a model; else the plugin.

    Raises:
        FileError: the file can't be read.
        SceneError: the scene is wrong, a parameter is missing or unused; the message names the file, of XML the line.
    """
    from djpt.description import loader  # names of scenes are checked without NumPy

    if not is_model(path):
        return loader.load_file(path, parallel, optimize, trusted=trusted, root=root, **parameters)
    if trusted and root is not None:
        raise SceneError("'root' confines scenes that aren't trusted; set trusted=False, too")
    return loader.load_dict(read_model(Path(path), root, **parameters), parallel, optimize)
