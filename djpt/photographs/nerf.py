"""NeRF's `transforms.json`: the flavours of Blender's synthetic data sets, of instant-ngp and of nerfstudio.

B. Mildenhall et al., "NeRF: Representing Scenes as Neural Radiance Fields for View Synthesis", ECCV 2020; T. Mueller et
al., "Instant Neural Graphics Primitives", ACM TOG 41 (2022).
"""

from __future__ import annotations

import math
import warnings
from collections import ChainMap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from djpt.errors import SceneError
from djpt.photographs.fields import integer, number, numbers
from djpt.photographs.lens import FISHEYE, LARGEST_SIDE, PERSPECTIVE, Lens
from djpt.photographs.photograph import Photographs, Pictures, from_opengl

__all__ = ["read_transforms"]

MODELS = {
    **dict.fromkeys(("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "PERSPECTIVE"), False),
    **dict.fromkeys(("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "FISHEYE"), True),
}
"""The values of `camera_model` that sensors have, each with whether it is a fisheye."""

FOREIGN = ("latlong", "ftheta_p0", "ftheta_p1")
"""Entries of lenses that no sensor has."""


def read_transforms(json: Mapping[str, Any], name: str, pictures: Pictures) -> Photographs:
    """Read a `transforms.json`.

    The camera looks along its -z, with +y up. Entries of a frame win over those at the top: `transform_matrix`,
    `file_path`, `w`, `h` (default: those of the picture), `fl_x` or `camera_angle_x`, `fl_y` or `camera_angle_y`
    (default: that of x), `cx` and `cy` (the middle), `k1` .. `k4`, `p1`, `p2` (0), `is_fisheye`, `camera_model`.

    Args:
        json: the contents.
        name: of the file, for messages.
        pictures: where the photographs are.

    Raises:
        SceneError: the file is damaged, or no sensor has its lens.
    """
    frames = json.get("frames")
    if not isinstance(frames, list):
        raise SceneError(f"{name}: 'frames' must be a list")
    views = []
    for n, frame in enumerate(frames):
        where = f"{name}: frames[{n}]"
        if not isinstance(frame, dict):
            raise SceneError(f"{where} must be an object")
        entries = ChainMap(frame, {key: value for key, value in json.items() if key != "frames"})
        matrix = np.eye(4)
        rows = numbers(frame.get("transform_matrix"), f"{where}: 'transform_matrix'", (4, 4), (3, 4))
        matrix[:3] = rows[:3]
        path = frame.get("file_path", f"frames[{n}]")
        if not isinstance(path, str):
            raise SceneError(f"{where}: 'file_path' must be a string")
        found = pictures.find(path, n)
        try:
            lens = lens_of(entries, found, pictures, where)
        except SceneError as error:
            raise SceneError(str(error) if str(error).startswith(where) else f"{where}: {error}") from None
        if any(as_numbers(entries.get("rolling_shutter"))):
            warnings.warn(f"{name}: 'rolling_shutter' is left out: set that of the sensors", stacklevel=3)
        views.append(pictures.view(path, n, lens, from_opengl(matrix, f"{where}: 'transform_matrix'")))
    return Photographs(name, views)


def lens_of(entries: Mapping[str, Any], found: Path | None, pictures: Pictures, where: str) -> Lens:
    """The lens of a frame.

    Args:
        entries: of the frame and the file.
        found: its picture, if it is there.
        pictures: where the photographs are.
        where: for messages.

    Raises:
        SceneError: an entry is missing or wrong.
    """

    def given(key: str) -> float:
        return number(entries[key], f"{where}: '{key}'")

    for key in FOREIGN:
        if entries.get(key):
            raise SceneError(f"{where}: '{key}' is of a lens that no sensor has")
    model = entries.get("camera_model", "OPENCV_FISHEYE" if entries.get("is_fisheye") else "OPENCV")
    if not isinstance(model, str) or model not in MODELS:
        raise SceneError(
            f"{where}: no sensor has the 'camera_model' {str(model)[:40]!r}; possible: {', '.join(MODELS)}"
        )
    if "w" in entries and "h" in entries:
        width, height = (integer(entries[key], f"{where}: '{key}'", 1, LARGEST_SIDE) for key in "wh")
    else:
        width, height = pictures.size(found, where)
    focal = {}
    for axis, side in (("x", width), ("y", height)):
        if f"fl_{axis}" in entries:
            focal[axis] = given(f"fl_{axis}")
        elif f"camera_angle_{axis}" in entries:
            angle = given(f"camera_angle_{axis}")
            if not 0 < angle < math.pi:
                raise SceneError(f"{where}: 'camera_angle_{axis}' must be between 0 and pi, found {angle:g}")
            focal[axis] = 0.5 * side / math.tan(0.5 * angle)
    if not focal:
        raise SceneError(f"{where}: has no focal length: neither 'fl_x' nor 'camera_angle_x'")
    center = {key: given(key) if key in entries else 0.5 * side for key, side in (("cx", width), ("cy", height))}
    fisheye = MODELS[model] or bool(entries.get("is_fisheye"))
    coefficients = {key: given(key) for key in PERSPECTIVE if key in entries}
    coefficients = {key: value for key, value in coefficients.items() if value}
    for key in coefficients:
        # Beyond, programs disagree: k4 is that of r^8, or of the denominator.
        if key not in (FISHEYE if fisheye else ("k1", "k2", "k3", "p1", "p2")):
            raise SceneError(f"{where}: a camera of the model {model} has no '{key}'")
    x, y = focal.get("x", focal.get("y", 0.0)), focal.get("y", focal.get("x", 0.0))
    return Lens(width, height, x, y, **center, fisheye=fisheye, coefficients=coefficients)


def as_numbers(value: Any) -> list[Any]:
    """A list, or an empty one in place of something else."""
    return value if isinstance(value, list) else []
