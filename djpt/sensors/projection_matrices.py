"""Projections of cameras as transforms: from camera space to the crop window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number
from djpt.core.transforms.lanes import ProjectiveTransform4f
from djpt.description.properties import Properties
from djpt.jit.types import Matrix4f, ScalarArray2u
from djpt.sensors.projective import horizontal_fov

__all__ = ["orthographic_projection", "parse_fov", "perspective_projection"]

Size: TypeAlias = Sequence[int] | ScalarArray2u
"""Columns and rows of pixels."""


def perspective_projection(
    film_size: Size,
    crop_size: Size,
    crop_offset: Size,
    fov_x: Any,
    near_clip: Any,
    far_clip: Any,
) -> ProjectiveTransform4f:
    """The projection of a pinhole camera, which looks along +z, to the crop window.

    x and y of the window go from 0 to 1, y downwards, z from 0 on the near plane to 1 on the far plane. `fov_x` is in
    degrees, for the width of the whole film.
    """
    near, far, tangent = as_number(near_clip), as_number(far_clip), math.tan(math.radians(as_number(fov_x)) / 2)
    share = far / (far - near)
    to_plane = np.array([[1 / tangent, 0, 0, 0], [0, 1 / tangent, 0, 0], [0, 0, share, -near * share], [0, 0, 1, 0]])
    return made(to_window(film_size, crop_size, crop_offset) @ to_plane)


def orthographic_projection(
    film_size: Size, crop_size: Size, crop_offset: Size, near_clip: Any, far_clip: Any
) -> ProjectiveTransform4f:
    """The projection of a camera with parallel rays along +z, which sees -1 <= x <= 1, to the crop window."""
    near, far = as_number(near_clip), as_number(far_clip)
    depth = 1 / (far - near)
    to_plane = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, depth, -near * depth], [0, 0, 0, 1]])
    return made(to_window(film_size, crop_size, crop_offset) @ to_plane)


def parse_fov(props: Properties, aspect: float) -> float:
    """The field of view along x in degrees, from the entries `fov` and `fov_axis`, or from `focal_length`.

    `aspect` is width / height of the film. Raises `SceneError` for entries that say nothing or contradict each other.
    """
    return horizontal_fov(props, aspect)


def to_window(film_size: Size, crop_size: Size, crop_offset: Size) -> NDArray[np.float64]:
    """The map of an image plane with -1 <= x <= 1, x to the left and y up, to the crop window."""
    size, crop, offset = (np.array([int(n) for n in pair], np.float64) for pair in (film_size, crop_size, crop_offset))
    aspect = size[0] / size[1]
    scale = np.array([-0.5, -0.5 * aspect]) * size / crop
    shift = (0.5 - offset / size) * size / crop
    return np.array([[scale[0], 0, 0, shift[0]], [0, scale[1], 0, shift[1]], [0, 0, 1, 0], [0, 0, 0, 1]])


def made(matrix: NDArray[np.float64]) -> ProjectiveTransform4f:
    """The transform of a matrix."""
    return ProjectiveTransform4f(Matrix4f(matrix.tolist()))
