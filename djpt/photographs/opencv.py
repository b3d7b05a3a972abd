"""Calibrations of OpenCV: matrices and coefficients, as arrays or from its YAML and JSON files, and those of ROS.

Z. Zhang, "A Flexible New Technique for Camera Calibration", IEEE TPAMI 22 (2000).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from djpt.errors import SceneError
from djpt.photographs.fields import integer, listed, numbers, shown
from djpt.photographs.lens import FISHEYE, LARGEST_SIDE, Lens
from djpt.photographs.photograph import Photographs, Pictures, from_opencv

__all__ = ["of_matrices", "parsed_yaml", "read_calibration"]

Array = NDArray[np.float64]

ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""The coefficients in OpenCV's order."""
BEYOND = ("s1", "s2", "s3", "s4", "tau_x", "tau_y")
"""What comes behind them, of thin prisms and tilted sensors."""

KEYS = {
    "camera matrix": ("camera_matrix", "cameramatrix", "k", "intrinsic_matrix", "intrinsics", "mtx"),
    "distortion": ("distortion_coefficients", "distcoeffs", "dist_coeffs", "distortion", "d", "dist"),
    "width": ("image_width", "imagewidth", "width"),
    "height": ("image_height", "imageheight", "height"),
    "rotation": ("r", "rotation", "rotation_matrix", "rvec", "rvecs"),
    "translation": ("t", "translation", "tvec", "tvecs"),
    "extrinsic parameters": ("extrinsic_parameters",),
}
"""Names that programs give to the same thing, in any case, the usual ones first."""

MODELS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True}
"""The values of `distortion_model`, each with whether it is a fisheye."""

LARGEST_TEXT = 2**20
"""The most bytes of a YAML file: parsers need long for large ones."""


def of_matrices(
    matrix: ArrayLike,
    distortion: ArrayLike | None = None,
    rotation: ArrayLike | None = None,
    translation: ArrayLike | None = None,
    *,
    size: tuple[int, int],
    fisheye: bool = False,
    images: Any = (),
    name: str = "of_matrices",
) -> Photographs:
    """Cameras by the matrices of OpenCV: what `cv2.calibrateCamera` and `cv2.fisheye.calibrate` return.

    Args:
        matrix: (3, 3), K, in pixels from the centre of the first one; without a skew.
        distortion: k1, k2, p1, p2 (k3 (k4, k5, k6)), or k1 .. k4 of a fisheye; default: none.
        rotation: from the world to the camera: (3, 3), or a vector (3,) along the axis whose length is the angle; or N
            of either. Default: the identity.
        translation: x_camera = R x_world + t: (3,), or N of them. Default: 0.
        size: (width, height) of the pictures.
        fisheye: whether the coefficients are those of OpenCV's fisheye model.
        images: the photographs, a path for each, if there are any.
        name: for messages.

    Raises:
        SceneError: an array has another shape, the matrix a skew, or a coefficient means something that no sensor has.
    """
    pictures = images if isinstance(images, Pictures) else Pictures(images)
    lens = lens_of(matrix, distortion, size, fisheye, name)
    turns = rotations(np.zeros(3) if rotation is None else rotation, f"{name}: the rotation")
    moves = numbers(np.zeros(3) if translation is None else translation, f"{name}: the translation")
    if moves.size % 3 or (len(turns) != moves.size // 3 and 1 not in (len(turns), moves.size // 3)):
        raise SceneError(f"{name}: there are {len(turns)} rotations and {moves.size} numbers of translations")
    count = max(len(turns), moves.size // 3)
    places = np.broadcast_to(moves.reshape(-1, 3), (count, 3))
    views = []
    for n, (turn, move) in enumerate(zip(np.broadcast_to(turns, (count, 3, 3)), places, strict=True)):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.T, -turn.T @ move
        views.append(pictures.view(f"view {n}", n, lens, from_opencv(matrix, f"{name}: view {n}")))
    return Photographs(name, views)


def lens_of(matrix: Any, distortion: Any, size: tuple[int, int], fisheye: bool, where: str) -> Lens:
    """The lens of a camera matrix and coefficients."""
    k = numbers(matrix, f"{where}: the camera matrix", (3, 3))
    if k[0, 1] or k[1, 0] or k[2].tolist() != [0, 0, 1]:
        raise SceneError(f"{where}: the camera matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]: {k.tolist()}")
    values = numbers(() if distortion is None else distortion, f"{where}: the distortion").ravel().tolist()
    names = FISHEYE if fisheye else (*ORDER, *BEYOND)
    if len(values) > len(names):
        raise SceneError(f"{where}: there are at most {len(names)} coefficients, found {len(values)}")
    coefficients = {key: value for key, value in zip(names, values, strict=False) if value}
    beyond = [key for key in coefficients if key in BEYOND]
    if beyond:
        raise SceneError(f"{where}: no sensor has the coefficient '{beyond[0]}' of thin prisms and tilted sensors")
    try:
        # OpenCV counts from the centre of the first pixel.
        centre = float(k[0, 2]) + 0.5, float(k[1, 2]) + 0.5
        return Lens(*size, float(k[0, 0]), float(k[1, 1]), *centre, fisheye=fisheye, coefficients=coefficients)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None


def rotations(values: ArrayLike, what: str) -> Array:
    """Rotations (N, 3, 3) by matrices or by vectors along their axes (O. Rodrigues, 1840).

    Raises:
        SceneError: the shape is that of neither.
    """
    found = numbers(values, what)
    if found.shape[-2:] == (3, 3):
        return found.reshape(-1, 3, 3)
    found = np.squeeze(found)
    if found.ndim not in (1, 2) or found.shape[-1] != 3:
        raise SceneError(f"{what} must be matrices 3 x 3 or vectors of 3 numbers, found the shape {found.shape}")
    vectors = found.reshape(-1, 3)
    angles = np.linalg.norm(vectors, axis=1)
    x, y, z = vectors.T / np.maximum(angles, 1e-300)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sin * cross + (1 - cos) * (cross @ cross)


# ---- files -----------------------------------------------------------------------------------


def read_calibration(fields: Mapping[str, Any], name: str, pictures: Pictures) -> Photographs:
    """Read a calibration: one camera, at one place or at each of those of the calibration.

    Args:
        fields: the contents of the file.
        name: its name, for messages.
        pictures: where the photographs are: the file doesn't name them.

    Raises:
        SceneError: the matrix or the size is missing, or something is damaged.
    """
    fields = {key.lower(): value for key, value in fields.items()}
    found = {what: next((fields[key] for key in keys if key in fields), None) for what, keys in KEYS.items()}
    if found["camera matrix"] is None:
        raise SceneError(
            f"{name}: has no camera matrix; possible: {', '.join(KEYS['camera matrix'])}; found: {listed(fields)}"
        )
    if found["width"] is not None and found["height"] is not None:
        width, height = (integer(found[key], f"{name}: the {key}", 1, LARGEST_SIDE) for key in ("width", "height"))
    else:
        width, height = pictures.size(pictures.find("", 0), name)
    model = fields.get("distortion_model", "plumb_bob")
    if model not in MODELS:
        raise SceneError(f"{name}: no sensor has the 'distortion_model' {str(model)[:40]!r}")
    fisheye = MODELS[model] or str(fields.get("fisheye_model", "")).lower() in ("1", "true")
    matrix = array(found["camera matrix"], f"{name}: the camera matrix")
    distortion, rotation, translation, both = (
        None if found[what] is None else array(found[what], f"{name}: the {what}")
        for what in ("distortion", "rotation", "translation", "extrinsic parameters")
    )
    if both is not None:
        if both.ndim != 2 or both.shape[1] != 6:
            raise SceneError(f"{name}: the extrinsic parameters must have 6 columns, found the shape {both.shape}")
        rotation, translation = both[:, :3], both[:, 3:]
    return of_matrices(
        matrix, distortion, rotation, translation, size=(width, height), fisheye=fisheye, images=pictures, name=name
    )


def array(value: Any, what: str) -> Array:
    """Numbers of a file: a list, or an object with `data` and `rows` and `cols`, or `sizes`."""
    if not isinstance(value, Mapping):
        return numbers(value, what)
    data = numbers(value.get("data"), what).ravel()
    sizes = value.get("sizes", [value.get("rows"), value.get("cols")])
    if not isinstance(sizes, list):
        raise SceneError(f"{what}: 'sizes' must be a list")
    shape = [integer(size, f"{what}: 'rows', 'cols' and 'sizes'") for size in sizes]
    if math.prod(shape) != data.size:
        raise SceneError(f"{what}: {' x '.join(map(str, shape))} need other data than {data.size} numbers")
    return data.reshape(shape)


def parsed_yaml(data: bytes, name: str) -> dict[str, Any]:
    """The contents of a YAML file, also with OpenCV's header and its types; numbers are left as texts.

    Raises:
        SceneError: it is damaged or too large, or PyYAML isn't installed.
    """
    try:
        import yaml
    except ImportError:
        raise SceneError(f"{name}: YAML is read by PyYAML, which isn't installed: pip install pyyaml") from None
    if len(data) > LARGEST_TEXT:
        raise SceneError(f"{name}: has {len(data)} bytes; calibrations have at most {LARGEST_TEXT}")
    text = data.decode("utf-8", "replace").removeprefix("\ufeff")
    if text.startswith("%YAML:"):  # YAML itself has a blank there
        text = text.partition("\n")[2]
    left = len(data) + 1  # nodes: aliases would multiply them

    def plain(node: Any) -> Any:
        nonlocal left
        left -= 1
        if left < 0:
            raise SceneError(f"{name}: refers to itself")
        if isinstance(node, yaml.MappingNode):
            return {str(plain(key)): plain(value) for key, value in node.value}
        return [plain(entry) for entry in node.value] if isinstance(node, yaml.SequenceNode) else node.value

    try:
        found = plain(yaml.compose(text, yaml.SafeLoader) or yaml.ScalarNode("", ""))
    except (yaml.YAMLError, RecursionError) as error:
        raise SceneError(f"{name}: isn't YAML: {' '.join(str(error).split())[:200]}") from None
    if not isinstance(found, dict):
        raise SceneError(f"{name}: must hold keys and values, found {shown(found)}")
    return found
