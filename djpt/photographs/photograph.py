"""Photographs with known cameras: as sensors, and as targets of an optimisation."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from djpt.core.files import shortened
from djpt.core.transforms import ScalarTransform4f
from djpt.errors import FileError, SceneError
from djpt.images.image import read_pixels, reading, require_modest
from djpt.images.srgb import from_srgb
from djpt.models.folder import Folder
from djpt.photographs.fields import LARGEST, integer, numbers
from djpt.photographs.lens import LARGEST_SIDE, AllAround, Lens

__all__ = ["Photograph", "Photographs", "Pictures", "from_opencv", "from_opengl", "linear"]

Matrix = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.float32]

SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".JPG", ".PNG", ".exr", ".tif")
"""What is tried behind the name of a photograph; Blender's data sets leave the suffix out."""

RIGID = 1e-2
"""How far the axes of a camera may be from a rotation, in their length."""

SAME_ASPECT = 0.02
"""How far the ratio of a picture's sides may be from that of its lens."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph and its camera.

    * `name`: as the file says.
    * `size`: width and height by the file, while `lens` has those of the sensor and the target.
    * `to_world`: from the camera's space, where x points to the left, y up and z ahead, to the world, (4, 4).
    * `path`: the picture, None if it isn't there; `folder` is where it was looked for.
    """

    name: str
    size: tuple[int, int]
    lens: Lens | AllAround
    to_world: Matrix
    path: Path | None = None
    folder: str = ""

    def sensor(self, **entries: Any) -> dict[str, Any]:
        """The description of a sensor that sees what was photographed.

        Args:
            entries: more entries of the sensor, such as ``near_clip`` or ``sampler``; they win.
        """
        film = {"type": "hdrfilm", "width": self.lens.width, "height": self.lens.height, "rfilter": {"type": "box"}}
        return {**self.lens.entries(), "to_world": ScalarTransform4f(self.to_world), "film": film, **entries}

    def target(self, background: float = 0.0) -> Pixels:
        """The picture, (H, W, 3) float32, linear, with the size of the lens.

        Pixels are means of the picture's where it is larger. Where it has an alpha channel, it is laid over a grey
        `background`; 0, the default, is what a scene without a sky shows there.

        Raises:
            FileError: the picture isn't there, can't be read, or its sides have another ratio than `size`.
        """
        if self.path is None:
            raise FileError(f"the photograph '{shortened(self.name)}' isn't in '{self.folder}'")
        require_modest(self.path)
        pixels = np.asarray(read_pixels(self.path), np.float64)
        rows, columns = pixels.shape[:2]
        width, height = self.size
        if abs(math.log(columns / rows * height / width)) > SAME_ASPECT:
            raise FileError(
                f"'{self.path}' has {columns} x {rows} pixels, its camera {width} x {height}, which is another ratio"
            )
        if pixels.shape[2] in (2, 4):
            alpha = pixels[..., -1:]
            # Colours in OpenEXR are multiplied by alpha already.
            shares = 1 if self.path.suffix.lower() == ".exr" else alpha
            pixels = pixels[..., :-1] * shares + background * (1 - alpha)
        if pixels.shape[2] == 1:
            pixels = np.repeat(pixels, 3, axis=2)
        pixels = averaged(averaged(pixels[..., :3], self.lens.height, 0), self.lens.width, 1)
        return np.ascontiguousarray(pixels, np.float32)


@dataclass(frozen=True, eq=False)
class Photographs(Sequence[Photograph]):
    """Photographs of one thing, in order.

    * `name`: of the file, for messages.
    * `points` (N, 3) and `colors` (N, 3), linear: the points in space that were found on them, if they were asked for.

    Indices give a `Photograph`, slices and lists of indices `Photographs`.
    """

    name: str
    views: Sequence[Photograph]
    points: Matrix = field(default_factory=lambda: np.zeros((0, 3)))
    colors: Matrix = field(default_factory=lambda: np.zeros((0, 3)))

    def __len__(self) -> int:
        return len(self.views)

    def __iter__(self) -> Iterator[Photograph]:
        return iter(self.views)

    @overload
    def __getitem__(self, index: int) -> Photograph: ...

    @overload
    def __getitem__(self, index: slice | Iterable[int]) -> Photographs: ...  # type: ignore[override, unused-ignore]

    def __getitem__(self, index: int | slice | Iterable[int]) -> Photograph | Photographs:
        if isinstance(index, slice):
            return replace(self, views=self.views[index])
        if isinstance(index, Iterable):
            return replace(self, views=[self.views[i] for i in index])
        return self.views[index]

    def __repr__(self) -> str:
        found = sum(view.path is not None for view in self.views)
        return f"Photographs('{self.name}': {len(self)} cameras, {found} pictures, {len(self.points)} points)"

    def resized(self, width: int, height: int | None = None) -> Photographs:
        """The same with other numbers of pixels; without a `height` the ratios of the sides are kept."""

        def changed(lens: Lens | AllAround) -> Lens | AllAround:
            rows = max(1, round(lens.height * width / lens.width)) if height is None else height
            return lens.resized(width, rows)

        return replace(self, views=[replace(view, lens=changed(view.lens)) for view in self.views])

    def sensors(self, **entries: Any) -> dict[str, dict[str, Any]]:
        """The sensors of a scene, in order, for ``{"type": "scene", **photographs.sensors(), ..}``.

        Args:
            entries: more entries of each sensor.
        """
        return {f"view_{i:05}": view.sensor(**entries) for i, view in enumerate(self.views)}

    def batch(self, **entries: Any) -> dict[str, Any]:
        """One `batch` sensor of all cameras, which one kernel renders side by side; its target is `strip`.

        Args:
            entries: more entries of each sensor.

        Raises:
            SceneError: there are no photographs, or they differ in size; see `resized`.
        """
        width, height = self._one_size()
        film = {"type": "hdrfilm", "width": len(self) * width, "height": height, "rfilter": {"type": "box"}}
        return {"type": "batch", "film": film, **self.sensors(**entries)}

    def targets(self, background: float = 0.0) -> list[Pixels]:
        """The pictures for `djpt.optimize` with `sensors`: see `Photograph.target`."""
        return [view.target(background) for view in self.views]

    def strip(self, background: float = 0.0) -> Pixels:
        """The pictures side by side, (H, N W, 3), as `batch` shows them."""
        self._one_size()
        return np.concatenate(self.targets(background), axis=1)

    def _one_size(self) -> tuple[int, int]:
        """The size of all photographs; raises `SceneError` if they differ."""
        sizes = sorted({(view.lens.width, view.lens.height) for view in self.views})
        if not sizes:
            raise SceneError(f"{self.name}: there are no photographs to put side by side")
        if len(sizes) > 1:
            found = " and ".join(f"{w} x {h}" for w, h in sizes[:2])
            raise SceneError(
                f"{self.name}: photographs side by side must have one size, found {found}: use "
                "resized(width, height), or sensors() in place of batch()"
            )
        return sizes[0]


# ---- where cameras are -----------------------------------------------------------------------


def from_opencv(to_world: Matrix, what: str) -> Matrix:
    """Our `to_world` of a camera whose x points to the right, y down and z ahead (OpenCV, COLMAP); (4, 4)."""
    return placed(to_world, (-1.0, -1.0, 1.0), what)


def from_opengl(to_world: Matrix, what: str) -> Matrix:
    """Our `to_world` of a camera whose x points to the right, y up and z backwards (OpenGL, Blender, NeRF); (4, 4)."""
    return placed(to_world, (-1.0, 1.0, -1.0), what)


def placed(to_world: Matrix, signs: tuple[float, float, float], what: str) -> Matrix:
    """A matrix with some axes reversed and made a rotation to the last bit.

    Raises:
        SceneError: the axes aren't at right angles, mirror, or differ in length, or numbers are too large.
    """
    matrix = np.array(to_world, np.float64)
    if not (np.abs(matrix) <= LARGEST).all():
        raise SceneError(f"{what} has no place: {matrix[:3].tolist()}")
    u, lengths, v = np.linalg.svd(matrix[:3, :3])
    if not (lengths[2] > (1 - RIGID) * lengths[0] and np.linalg.det(u @ v) > 0):
        raise SceneError(f"{what} isn't a rotation: {matrix[:3, :3].tolist()}")
    result = np.eye(4)
    result[:3, :3] = (u @ v) * signs
    result[:3, 3] = matrix[:3, 3]
    return result


# ---- pictures --------------------------------------------------------------------------------


class Pictures:
    """Where photographs are looked for.

    Args:
        images: a folder; or pictures one by one, in the order of the cameras.
        size: (width, height) of pictures that aren't there.

    Raises:
        FileError: there is no such folder.
        SceneError: the size isn't one.
    """

    def __init__(
        self,
        images: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        size: tuple[int, int] | None = None,
    ) -> None:
        one = isinstance(images, (str, os.PathLike))
        self.folder = Folder(images) if one else None  # type: ignore[arg-type]
        self.paths = [] if one else [Path(path) for path in images]  # type: ignore[union-attr]
        if self.folder is not None and not os.path.isdir(self.folder.path):
            raise FileError(f"there is no folder '{shortened(images)}' of photographs")
        self.given: tuple[int, int] | None = None
        if size is not None:
            width, height = (integer(n, "'size'", 1, LARGEST_SIDE) for n in numbers(size, "'size'", (2,)).tolist())
            self.given = width, height

    def find(self, name: str, number: int) -> Path | None:
        """The picture of a camera, by its name or, where they were given one by one, its number; or None.

        In a folder, a name is looked for as it is, then without the folders in it. Nothing outside is found.
        """
        if self.folder is None:
            return self.paths[number] if number < len(self.paths) else None
        name = name.replace("\\", "/")
        for candidate in dict.fromkeys((name, name.rpartition("/")[2])):
            for suffix in SUFFIXES:
                path = os.path.join(self.folder.path, candidate + suffix)
                if os.path.isfile(path) and self.folder.contains(path):
                    return Path(path)
        return None

    def size(self, path: Path | None, what: str) -> tuple[int, int]:
        """The width and height of a picture, by its header; raises `SceneError` if nobody knows."""
        if self.given is not None:
            return self.given
        if path is None:
            raise SceneError(f"{what}: its size isn't known, and its picture isn't there; give 'size' or 'images'")
        if path.suffix.lower() in (".exr", ".hdr", ".pfm", ".npy"):
            require_modest(path)
            rows, columns = read_pixels(path).shape[:2]
            return columns, rows
        from PIL import Image

        with reading(path), Image.open(path, formats=("PNG", "JPEG", "BMP", "TGA", "PPM", "TIFF")) as file:
            return file.size

    def view(self, name: str, number: int, lens: Lens | AllAround, to_world: Matrix) -> Photograph:
        """The photograph of a camera."""
        folder = "the given pictures" if self.folder is None else self.folder.path
        return Photograph(name, (lens.width, lens.height), lens, to_world, self.find(name, number), folder)


def linear(codes: Sequence[Sequence[int]]) -> Matrix:
    """Colours (N, 3) of codes in sRGB, 0 to 255."""
    return from_srgb(np.array(codes, np.uint8).reshape(1, -1, 3))[0].astype(np.float64)


def averaged(values: Matrix, count: int, axis: int) -> Matrix:
    """Means over `count` equal parts of an axis; parts may end within a sample."""
    values = np.moveaxis(values, axis, 0)
    length = values.shape[0]
    if count == length:
        return np.moveaxis(values, 0, axis)
    sums = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    at = np.arange(count + 1) * (length / count)
    lower = np.minimum(at.astype(np.int64), length - 1)
    share = (at - lower).reshape(-1, *[1] * (values.ndim - 1))
    means = np.diff(sums[lower] * (1 - share) + sums[lower + 1] * share, axis=0) * (count / length)
    return np.moveaxis(means, 0, axis)
