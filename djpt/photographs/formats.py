"""Which reader reads what: by the names in a folder, and the contents of a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from djpt.core.files import as_path, require_regular, shortened
from djpt.errors import FileError, SceneError
from djpt.models.folder import Folder
from djpt.photographs.photograph import Photographs, Pictures

__all__ = ["load_cameras"]

FOLDERS = ("", "sparse/0", "sparse")
"""Where COLMAP's files are in a folder."""

FILES = ("transforms.json", "transforms_train.json", "bundle.out", "bundle/bundle.out")
"""What else is looked for in a folder, in this order."""


def load_cameras(
    path: str | os.PathLike[str],
    images: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    *,
    size: tuple[int, int] | None = None,
    points: bool = False,
) -> Photographs:
    """Read the cameras with which photographs were taken. For example::

        photographs = djpt.load_cameras("fox/transforms.json").resized(135)
        scene = djpt.load_dict({"type": "scene", **photographs.sensors(), ..})
        djpt.optimize(scene, keys, photographs.targets())

    Args:
        path: one of

            * a reconstruction of COLMAP: the folder with `cameras` and `images` (`.bin` or `.txt`), one of these
              files, or the folder above `sparse`,
            * NeRF's `transforms.json`, of Blender, instant-ngp or nerfstudio, or its folder,
            * a calibration by OpenCV or ROS, `.yml`, `.yaml` (these need PyYAML, extra `photographs`) or `.json`,
            * Bundler's `bundle.out`, or its folder.
        images: the folder with the photographs; the default is the folder of the file, for COLMAP `images` beside or
            above it, if there is one. Or the photographs one by one, in the order of the cameras (by name for COLMAP):
            for calibrations, which don't name any. Nothing outside of the folder is read, whatever names a file has.
        size: (width, height) of the photographs where the file doesn't say; default: that of each picture.
        points: read the points in space that a reconstruction has, too.

    Returns:
        `djpt.photographs.photograph.Photographs`: in order of names for COLMAP, else that of the file. Their units are
        those of the file, and so are their axes: z is up in Blender's data sets, and COLMAP's are arbitrary.

    Raises:
        FileError: a file can't be read, or the folder holds no cameras.
        SceneError: it is damaged, a size isn't known, or a camera has a lens that no sensor has.
    """
    from djpt.photographs.bundler import read_bundle
    from djpt.photographs.colmap import read_colmap
    from djpt.photographs.fields import parsed_json
    from djpt.photographs.nerf import read_transforms
    from djpt.photographs.opencv import parsed_yaml, read_calibration

    source = file_in(as_path(path))
    folder, name = Folder(source.parent), source.name
    try:
        if is_colmap(source):
            return read_colmap(folder, Pictures(beside(source.parent) if images is None else images, size), points)
        pictures = Pictures(source.parent if images is None else images, size)
        data = folder.read(name)
        if data.startswith(b"# Bundle file") or source.suffix == ".out":
            return read_bundle(data, name, folder, pictures, points)
        if source.suffix.lower() == ".json":
            fields = parsed_json(data, name)
            return (
                read_transforms(fields, name, pictures)
                if "frames" in fields
                else read_calibration(fields, name, pictures)
            )
        if source.suffix.lower() in (".yml", ".yaml"):
            return read_calibration(parsed_yaml(data, name), name, pictures)
    except (OverflowError, RecursionError) as error:
        raise SceneError(f"{name}: numbers out of range: {error}") from None
    except MemoryError:
        raise SceneError(f"{name}: doesn't fit into memory") from None
    raise FileError(
        f"'{shortened(source)}' holds no cameras; possible: cameras.bin, cameras.txt, bundle.out, .json, .yml, .yaml"
    )


def is_colmap(path: Path) -> bool:
    """True if a file is one of COLMAP's."""
    return path.stem in ("cameras", "images", "points3D") and path.suffix in (".bin", ".txt")


def file_in(path: Path) -> Path:
    """The file with cameras: `path` itself, or the one in this folder.

    Raises:
        FileError: there is none.
    """
    if not path.is_dir():
        require_regular(path)
        return path
    for inner in FOLDERS:
        for name in ("cameras.bin", "cameras.txt"):
            if (path / inner / name).is_file():
                return path / inner / name
    for name in FILES:
        if (path / name).is_file():
            return path / name
    raise FileError(
        f"the folder '{shortened(path)}' holds no cameras; looked for cameras.bin and cameras.txt (also in sparse/0 "
        f"and sparse) and {', '.join(FILES)}"
    )


def beside(folder: Path) -> Path:
    """The folder `images` in, beside or above that of COLMAP's files; their own if there is none."""
    real = Path(os.path.realpath(folder))
    for place in (real, *real.parents[:2]):
        if (place / "images").is_dir():
            return place / "images"
    return folder
