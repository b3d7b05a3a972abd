"""Reconstructions of Bundler: `bundle.out`, and the names of the photographs in `list.txt` beside it.

N. Snavely, S. M. Seitz, R. Szeliski, "Photo Tourism", ACM TOG 25 (2006); the format is that of Bundler's manual.
"""

from __future__ import annotations

import numpy as np

from djpt.errors import FileError, SceneError
from djpt.models.folder import Folder
from djpt.photographs.fields import integer, number, numbers
from djpt.photographs.lens import Lens
from djpt.photographs.photograph import Photographs, Pictures, from_opengl, linear

__all__ = ["read_bundle"]

NUMBERS = 15
"""The numbers of a camera: f, k1, k2, the rotation by rows, the translation."""


def read_bundle(data: bytes, name: str, folder: Folder, pictures: Pictures, points: bool = False) -> Photographs:
    """Read a `bundle.out`.

    A camera looks along its -z, with +y up; x_camera = R x_world + t. The picture's middle is the principal point.
    Cameras that Bundler couldn't place, whose f is 0, are left out.

    Args:
        data: the file's contents.
        name: its name.
        folder: where `list.txt` is.
        pictures: where the photographs are; their sizes are not in the file.
        points: read the points in space, too.

    Raises:
        SceneError: the file is damaged, or the size of a photograph isn't known.
    """
    head, _, text = data.decode("ascii", "replace").partition("\n")
    if not head.startswith("# Bundle file"):
        raise SceneError(f"{name}: isn't a file of Bundler: it doesn't begin with '# Bundle file'")
    words = text.split()
    if len(words) < 2:
        raise SceneError(f"{name}: ends within its header")
    cameras, count = (integer(word, f"{name}: a count") for word in words[:2])
    at = 2 + NUMBERS * cameras
    if at > len(words):
        raise SceneError(f"{name}: ends within its {cameras} cameras")
    names = names_of(folder)
    views = []
    for n in range(cameras):
        where = f"{name}: camera {n}"
        row = numbers([number(word, where) for word in words[2 + NUMBERS * n : 2 + NUMBERS * (n + 1)]], where)
        if row[0] == 0:
            continue
        label = names[n] if n < len(names) else f"camera {n}"
        width, height = pictures.size(pictures.find(label, n), where)
        distortion = {key: float(value) for key, value in zip(("k1", "k2"), row[1:3], strict=True) if value}
        try:
            focal = float(row[0])
            lens = Lens(width, height, focal, focal, 0.5 * width, 0.5 * height, coefficients=distortion)
        except SceneError as error:
            raise SceneError(f"{where}: {error}") from None
        rotation, matrix = row[3:12].reshape(3, 3), np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation.T, -rotation.T @ row[12:]
        views.append(pictures.view(label, n, lens, from_opengl(matrix, where)))
    if not points:
        return Photographs(name, views)
    places, colors = [], []
    for n in range(count):
        where = f"{name}: point {n}"
        if at + 7 > len(words):
            raise SceneError(f"{name}: ends within its {count} points")
        places.append([number(word, where) for word in words[at : at + 3]])
        colors.append([integer(word, where, 0, 255) for word in words[at + 3 : at + 6]])
        # Where it was found: four numbers for each photograph.
        at += 7 + 4 * integer(words[at + 6], where, 0, cameras)
    return Photographs(name, views, np.array(places, np.float64).reshape(-1, 3), linear(colors))


def names_of(folder: Folder) -> list[str]:
    """The photographs that `list.txt` names, one in each line, before other words; none if there is no such file."""
    try:
        text = folder.read("list.txt").decode("utf-8", "replace")
    except FileError:
        return []
    return [line.split()[0] for line in text.splitlines() if line.strip()]
