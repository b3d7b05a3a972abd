"""Reconstructions of COLMAP: its cameras, images and points in space, as texts or binary.

J. L. Schoenberger and J.-M. Frahm, "Structure-from-Motion Revisited", CVPR 2016; the format is that of COLMAP's manual,
"Output Format".
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from djpt.core.files import shortened
from djpt.errors import SceneError, near_miss
from djpt.models.folder import Folder
from djpt.photographs.fields import integer, number, numbers
from djpt.photographs.lens import LARGEST_SIDE, AllAround, Lens
from djpt.photographs.photograph import Photographs, Pictures, from_opencv, linear

__all__ = ["MODELS", "lens_of", "read_colmap"]

MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "EQUIRECTANGULAR": "w h",
}
"""The parameters of the camera models that sensors have, in the order of files."""

NUMBERED = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV"),
    *("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"),
    *("SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR"),
)
"""All camera models, by their numbers in binary files."""


class Image(NamedTuple):
    """An image of the reconstruction."""

    name: str
    rotation: Sequence[float]
    """From the world to the camera, a quaternion (w, x, y, z)."""
    translation: Sequence[float]
    camera: int
    where: str
    """For messages."""


def read_colmap(folder: Folder, pictures: Pictures, points: bool = False) -> Photographs:
    """Read a reconstruction.

    Args:
        folder: with `cameras` and `images`, `.bin` or else `.txt`.
        pictures: where the photographs are.
        points: read `points3D`, too.

    Raises:
        FileError: a file is missing or can't be read.
        SceneError: one is damaged, or has a camera model that no sensor has.
    """
    suffix = suffix_in(folder)
    binary = suffix == ".bin"
    data = {name: folder.read(name + suffix) for name in ("cameras", "images", *(["points3D"] if points else []))}
    cameras = dict(binary_cameras(data["cameras"]) if binary else text_cameras(data["cameras"]))
    views = []
    found = binary_images(data["images"]) if binary else text_images(data["images"])
    for n, image in enumerate(sorted(found, key=lambda image: image.name)):
        if image.camera not in cameras:
            raise SceneError(f"{image.where}: there is no camera {image.camera} in cameras{suffix}")
        place = from_opencv(camera_to_world(image), image.where)
        views.append(pictures.view(image.name, n, cameras[image.camera], place))
    if not points:
        return Photographs(f"images{suffix}", views)
    cloud = list(binary_points(data["points3D"]) if binary else text_points(data["points3D"]))
    places = numbers([place for place, _ in cloud], f"points3D{suffix}: the places of points").reshape(-1, 3)
    return Photographs(f"images{suffix}", views, places, linear([color for _, color in cloud]))


def suffix_in(folder: Folder) -> str:
    """The suffix of the files, the binary ones first, as in COLMAP."""
    found = [os.path.isfile(os.path.join(folder.path, f"{name}.bin")) for name in ("cameras", "images")]
    return ".bin" if all(found) else ".txt"


def lens_of(model: str, width: Any, height: Any, values: Sequence[Any], where: str) -> Lens | AllAround:
    """The lens of a camera model.

    Raises:
        SceneError: no sensor has it, the number of its parameters is wrong, or a panorama isn't a whole one.
    """
    if model not in MODELS:
        known = "a camera model that no sensor has" if model in NUMBERED else "not a camera model"
        raise SceneError(f"{where}: '{shortened(model)}' is {known}{near_miss(model, MODELS)}")
    names = MODELS[model].split()
    if len(values) != len(names):
        raise SceneError(f"{where}: {model} has {len(names)} parameters ({', '.join(names)}), found {len(values)}")
    found = {name: number(value, f"{where}: {name}") for name, value in zip(names, values, strict=True)}
    columns, rows = (integer(side, f"{where}: the size", 1, LARGEST_SIDE) for side in (width, height))
    if model == "EQUIRECTANGULAR":
        if (found["w"], found["h"]) != (columns, rows):
            turn = f"{found['w']:g} x {found['h']:g}"
            raise SceneError(f"{where}: {model} must have the size of the picture, {columns} x {rows}, found {turn}")
        return AllAround(columns, rows)
    focal = found.pop("f", 0.0)
    fx, fy, cx, cy = (found.pop(name, focal) for name in ("fx", "fy", "cx", "cy"))
    distortion = {name: value for name, value in found.items() if value}
    try:
        return Lens(columns, rows, fx, fy, cx, cy, fisheye="FISHEYE" in model, coefficients=distortion)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None


def camera_to_world(image: Image) -> NDArray[np.float64]:
    """From the space of the camera, x to the right, y down, z ahead, to the world, (4, 4)."""
    q = numbers(image.rotation, f"{image.where}: the rotation")
    t = numbers(image.translation, f"{image.where}: the translation")
    length = float(np.linalg.norm(q))
    if not length > 1e-6:
        raise SceneError(f"{image.where}: the rotation must be a quaternion of length 1, found {q.tolist()}")
    w, x, y, z = q / length
    to_camera = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = to_camera.T, -to_camera.T @ t
    return matrix


# ---- texts -----------------------------------------------------------------------------------


def lines_of(data: bytes) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers, but for comments."""
    for n, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        if not line.startswith("#"):
            yield n, line.strip()


def text_cameras(data: bytes) -> Iterator[tuple[int, Lens | AllAround]]:
    """Cameras: a line of id, model, width, height and parameters for each."""
    for n, line in lines_of(data):
        if line:
            where, words = f"cameras.txt, line {n}", line.split()
            if len(words) < 5:
                raise SceneError(f"{where}: a camera has an id, a model, a width, a height and parameters")
            yield integer(words[0], f"{where}: the id"), lens_of(words[1], words[2], words[3], words[4:], where)


def text_images(data: bytes) -> Iterator[Image]:
    """Images: a line of id, quaternion, translation, camera and name, and one of the points found on it, for each."""
    lines = lines_of(data)
    for n, line in lines:
        if not line:
            continue
        where, words = f"images.txt, line {n}", line.split(None, 9)
        if len(words) < 10:
            raise SceneError(f"{where}: an image has an id, 4 + 3 numbers for its place, a camera and a name")
        place = [number(word, f"{where}: the place") for word in words[1:8]]
        yield Image(words[9], place[:4], place[4:], integer(words[8], f"{where}: the camera"), where)
        n, line = next(lines, (n, ""))
        if len(line.split()) % 3:
            raise SceneError(
                f"images.txt, line {n}: expected the points found on '{shortened(words[9])}', three numbers for each"
            )


def text_points(data: bytes) -> Iterator[tuple[list[float], list[int]]]:
    """Places and colours of points: a line of id, place, colour, and more, for each."""
    for n, line in lines_of(data):
        if line:
            where, words = f"points3D.txt, line {n}", line.split(None, 7)
            if len(words) < 7:
                raise SceneError(f"{where}: a point has an id, a place and a colour")
            place = [number(word, f"{where}: the place") for word in words[1:4]]
            yield place, [integer(word, f"{where}: the colour", 0, 255) for word in words[4:7]]


# ---- binary ----------------------------------------------------------------------------------


class Reader:
    """Numbers one after the other, little-endian; raises `SceneError` at the end of the data."""

    def __init__(self, data: bytes, name: str) -> None:
        self.data, self.name, self.at = data, name, 0

    def read(self, form: str) -> tuple[Any, ...]:
        """The next numbers, in the form of `struct`."""
        start = self.at
        self.skip(struct.calcsize(form))
        return struct.unpack_from(form, self.data, start)

    def skip(self, size: int) -> None:
        """Leave out some bytes."""
        if size > len(self.data) - self.at:
            raise SceneError(f"{self.name}: ends within a record: it has {len(self.data)} bytes")
        self.at += size

    def count(self, least: int) -> int:
        """A number of records, each with at least so many bytes."""
        (found,) = self.read("<Q")
        if found * least > len(self.data) - self.at:
            raise SceneError(f"{self.name}: has {len(self.data)} bytes, too few for {found} records")
        return int(found)

    def text(self) -> str:
        """A text that ends with a zero."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise SceneError(f"{self.name}: ends within a name")
        found, self.at = self.data[self.at : end], end + 1
        return found.decode("utf-8", "replace")


def binary_cameras(data: bytes) -> Iterator[tuple[int, Lens | AllAround]]:
    """Cameras: id, number of the model, width, height and parameters."""
    reader = Reader(data, "cameras.bin")
    for _ in range(reader.count(24)):
        camera, model, width, height = reader.read("<IiQQ")
        where = f"cameras.bin, camera {camera}"
        name = NUMBERED[model] if 0 <= model < len(NUMBERED) else f"model {model}"
        values = reader.read(f"<{len(MODELS.get(name, '').split())}d")
        yield camera, lens_of(name, width, height, values, where)


def binary_images(data: bytes) -> Iterator[Image]:
    """Images: id, quaternion, translation, camera, name, and the points found on it."""
    reader = Reader(data, "images.bin")
    for _ in range(reader.count(73)):
        identifier, *place, camera = reader.read("<I7dI")
        image = Image(reader.text(), place[:4], place[4:], camera, f"images.bin, image {identifier}")
        reader.skip(24 * reader.count(24))
        yield image


def binary_points(data: bytes) -> Iterator[tuple[list[float], list[int]]]:
    """Places and colours of points: id, place, colour, error, and where each was found."""
    reader = Reader(data, "points3D.bin")
    for _ in range(reader.count(51)):
        _, x, y, z, red, green, blue, _ = reader.read("<Q3d3Bd")
        yield [x, y, z], [red, green, blue]
        reader.skip(8 * reader.count(8))
