"""Small files of cameras, written without the readers: COLMAP's, NeRF's, OpenCV's and Bundler's."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "HEIGHT",
    "MODELS",
    "PLACES",
    "WIDTH",
    "bundle",
    "calibration",
    "colmap_binary",
    "colmap_text",
    "rotation",
    "transforms",
    "write",
]

WIDTH, HEIGHT = 64, 48

MODELS: dict[str, tuple[int, list[float]]] = {
    "SIMPLE_PINHOLE": (0, [60, 31, 25]),
    "PINHOLE": (1, [60, 58, 31, 25]),
    "SIMPLE_RADIAL": (2, [60, 31, 25, -0.1]),
    "RADIAL": (3, [60, 31, 25, -0.1, 0.03]),
    "OPENCV": (4, [60, 58, 31, 25, -0.1, 0.03, 0.004, -0.003]),
    "OPENCV_FISHEYE": (5, [40, 39, 31, 25, 0.02, -0.01, 0.004, -0.001]),
    "FULL_OPENCV": (6, [60, 58, 31, 25, -0.1, 0.03, 0.004, -0.003, 0.01, 0.05, -0.02, 0.006]),
    "SIMPLE_RADIAL_FISHEYE": (8, [40, 31, 25, 0.02]),
    "RADIAL_FISHEYE": (9, [40, 31, 25, 0.02, -0.01]),
    "SIMPLE_FISHEYE": (14, [40, 31, 25]),
    "FISHEYE": (15, [40, 39, 31, 25]),
    "EQUIRECTANGULAR": (17, [WIDTH, HEIGHT]),
}
"""COLMAP's models, their numbers, and parameters: pixels count from the corner."""

PLACES: list[tuple[list[float], list[float]]] = [
    ([0.3, -0.2, 0.5], [0.1, 0.4, 3.0]),
    ([-0.1, 0.7, 0.2], [0.5, -0.2, 4.0]),
]
"""Rotations, as vectors, and translations from the world to cameras with x to the right, y down and z ahead."""

POINTS = [([0.1, -0.2, 0.3], [255, 128, 0]), ([1.0, 0.5, -0.4], [0, 60, 90])]


def rotation(vector: list[float]) -> np.ndarray:
    """The rotation by a vector, from its quaternion."""
    w, x, y, z = quaternion(vector)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def quaternion(vector: list[float]) -> list[float]:
    angle = float(np.linalg.norm(vector))
    return [np.cos(angle / 2), *(np.array(vector) / angle * np.sin(angle / 2)).tolist()]


def colmap_text(model: str = "OPENCV") -> dict[str, bytes]:
    """The text files of a reconstruction, by name."""
    numbers = " ".join(map(repr, MODELS[model][1]))
    images = "# Image list with two lines of data per image:\n"
    for n, (turn, move) in enumerate(PLACES):
        place = " ".join(f"{x!r}" for x in (*map(float, quaternion(turn)), *move))
        images += f"{n + 1} {place} 7 view {n}.png\n{'' if n else '1.5 2.5 -1 3.0 4.0 1'}\n"
    points = "".join(
        f"{n} {' '.join(map(repr, place))} {' '.join(map(str, color))} 0.5 1 0\n"
        for n, (place, color) in enumerate(POINTS)
    )
    return {
        "cameras.txt": f"# Camera list\n7 {model} {WIDTH} {HEIGHT} {numbers}\n".encode(),
        "images.txt": images.encode(),
        "points3D.txt": f"# 3D point list\n{points}".encode(),
    }


def colmap_binary(model: str = "OPENCV") -> dict[str, bytes]:
    """The binary files of the same reconstruction, by name; images in another order."""
    number, values = MODELS[model]
    cameras = struct.pack("<QIiQQ", 1, 7, number, WIDTH, HEIGHT) + struct.pack(f"<{len(values)}d", *values)
    images = struct.pack("<Q", len(PLACES))
    for n, (turn, move) in reversed(list(enumerate(PLACES))):
        images += struct.pack("<I7dI", n + 1, *quaternion(turn), *move, 7) + f"view {n}.png".encode() + b"\0"
        images += struct.pack("<Q", 0) if n else struct.pack("<QddQddQ", 2, 1.5, 2.5, 2**64 - 1, 3.0, 4.0, 1)
    points = struct.pack("<Q", len(POINTS))
    for n, (place, color) in enumerate(POINTS):
        points += struct.pack("<Q3d3BdQII", n, *place, *color, 0.5, 1, 1, 0)
    return {"cameras.bin": cameras, "images.bin": images, "points3D.bin": points}


def transforms(**entries: Any) -> dict[str, Any]:
    """A `transforms.json` of the same places: cameras look along -z, y is up."""
    frames = []
    for n, (turn, move) in enumerate(PLACES):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation(turn).T, -rotation(turn).T @ move
        frames.append({"file_path": f"./view {n}", "transform_matrix": (matrix * [1, -1, -1, 1]).tolist()})
    return {"w": WIDTH, "h": HEIGHT, "fl_x": 60.0, "fl_y": 58.0, "cx": 31.0, "cy": 25.0, "frames": frames, **entries}


def bundle() -> bytes:
    """A `bundle.out` of the same places, and of a camera that wasn't placed: cameras look along -z, y is up."""
    lines = ["# Bundle file v0.3", f"{len(PLACES) + 1} {len(POINTS)}", "0 0 0", *["0 0 0"] * 4]
    for turn, move in PLACES:
        lines.append("60.0 -0.1 0.03")
        lines += [" ".join(f"{x!r}" for x in row) for row in (rotation(turn) * [[1], [-1], [-1]]).tolist()]
        lines.append(f"{move[0]} {-move[1]} {-move[2]}")
    for place, color in POINTS:
        lines += [" ".join(map(str, place)), " ".join(map(str, color)), "2 0 4 -3.5 2.5 1 3 1.0 1.0"]
    return "\n".join(lines).encode()


def calibration() -> str:
    """A calibration as `cv::FileStorage` writes it."""
    rows = ", ".join(f"{x!r}" for turn, move in PLACES for x in (*turn, *move))
    return f"""%YAML:1.0
---
image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 60., 0., 30.5, 0., 58., 24.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 3.0e-02, 0.004, -0.003, 0.01 ]
extrinsic_parameters: !!opencv-matrix
   rows: {len(PLACES)}
   cols: 6
   dt: d
   data: [ {rows} ]
"""


def write(folder: Path, files: dict[str, Any]) -> Path:
    """Write files; objects become JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        data = content if isinstance(content, (str, bytes)) else json.dumps(content)
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return folder
