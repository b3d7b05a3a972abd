"""Parameter sets of every emitter: what the tests of all emitters run over.

An emitter is described by the entries that it adds to a scene; those `on_shape` come with their shape.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf
from tests.kit.axes import unit
from tests.kit.meshes import tetrahedron_file
from tests.kit.parameter_sets import slow_but_first

__all__ = ["NAMES", "RAYS_UNLIKE_MITSUBA", "UNLIKE_MITSUBA", "entry", "first_of_each", "plugin_of"]

Entry = dict[str, Any] | Callable[[], dict[str, Any]]

RECTANGLE = {
    "type": "rectangle",
    "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]).scale(0.7),
}


def picture(shape: dict[str, Any], **keys: Any) -> Callable[[], dict[str, Any]]:
    """A shape that shines with the colours of a bitmap; made anew, since Mitsuba takes the tensor's memory."""

    def make() -> dict[str, Any]:
        return {**shape, "emitter": {"type": "area", "radiance": image(**keys)}}

    return make


AWAY = T().look_at(origin=[-2, 3, 2.5], target=[-4, 6, 5], up=[0, 1, 0]).scale([0.7, 0.4, 1])
SPOT = T().look_at(origin=[-2, 3, 2.5], target=[0, -0.5, 0], up=[0, 1, 0])
TILTED = SPOT @ T().rotate([0, 0, 1], 30)
MIRRORED = SPOT @ T().scale([-1, 1, 1])
UPRIGHT = T().rotate([1, 0, 0], -90)
COLOURS = {"type": "checkerboard", "color0": {"type": "rgb", "value": [0.9, 0.2, 0.1]}, "color1": 0.4}


def image(**keys: Any) -> dict[str, Any]:
    """A bitmap of bright and dark colours; made anew, since Mitsuba takes the tensor's memory."""
    data = (6 * np.random.default_rng(0).random((6, 8, 3)) ** 4).astype(np.float32)
    return {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}


def sky_file(rows: int, columns: int, sun: float = 0.0) -> str:
    """A picture of a sky with dark and bright texels, and one as bright as a sun."""
    path = Path(tempfile.mkdtemp(prefix="djpt-")) / "sky.pfm"
    atexit.register(shutil.rmtree, path.parent, ignore_errors=True)
    texels = np.random.default_rng(2).random((rows, columns, 3)) ** 3
    texels[rows // 4, columns // 3] += sun
    djpt.write(path, texels.astype(np.float32))
    return str(path)


SETS: dict[str, dict[str, Entry]] = {
    "area": {
        "rectangle": {**RECTANGLE, "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6, 5, 4]}}},
        "sphere": {
            "type": "sphere",
            "center": [-2, 3, 2.5],
            "radius": 0.5,
            "emitter": {"type": "area", "radiance": 8.0},
        },
        "flipped rectangle": {
            **RECTANGLE,
            "to_world": AWAY,
            "flip_normals": True,
            "emitter": {"type": "area", "radiance": 6.0},
        },
        "disk": {**RECTANGLE, "type": "disk", "emitter": {"type": "area", "radiance": 8.0, "sampling_weight": 2.0}},
        "cylinder": {
            "type": "cylinder",
            "p0": [-2, 3, 2.5],
            "p1": [-1.5, 3, 2],
            "radius": 0.4,
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6, 1, 4]}},
        },
        "cube": {
            "type": "cube",
            "to_world": T().translate([-2, 3, 2.5]).rotate(unit(1, 2, 3), 50).scale([0.5, 0.3, 0.2]),
            "emitter": {"type": "area", "radiance": 9.0},
        },
        "mesh": {
            "type": "ply",
            "filename": tetrahedron_file(),
            "face_normals": True,
            "to_world": T().translate([-2, 2, 1]),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [6, 7, 8]}},
        },
        "bitmap rectangle": picture(RECTANGLE),
        "nearest bitmap rectangle": picture(RECTANGLE, filter_type="nearest", wrap_mode="clamp"),
        "turned bitmap rectangle": picture(RECTANGLE, to_uv=T().translate([0, 1, 0]).scale([1, -1, 1])),
        "bitmap sphere": picture({"type": "sphere", "center": [-2, 3, 2.5], "radius": 0.5}, wrap_mode="mirror"),
        "bitmap cylinder": picture({"type": "cylinder", "p0": [-2, 3, 2.5], "p1": [-1.5, 3, 2], "radius": 0.4}),
        "bitmap cube": picture({"type": "cube", "to_world": T().translate([-2, 3, 2.5]).scale(0.4)}),
        "checkerboard disk": {
            **RECTANGLE,
            "type": "disk",
            "emitter": {"type": "area", "radiance": {"type": "checkerboard", "color0": 8.0, "color1": 1.0}},
        },
    },
    "constant": {
        "colour": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}},
        "default": {"type": "constant"},
    },
    "directional": {
        "default": {"type": "directional", "to_world": T().rotate([1, 0, 0], 90)},
        "direction": {
            "type": "directional",
            "direction": [2, -3, -1],
            "irradiance": {"type": "rgb", "value": [3, 2, 1]},
        },
        "turned": {"type": "directional", "to_world": TILTED, "irradiance": 2.0, "sampling_weight": 3.0},
    },
    "directionalarea": {
        "rectangle": {**RECTANGLE, "emitter": {"type": "directionalarea", "radiance": 3.0}},
        "sphere": {
            "type": "sphere",
            "center": [-2, 3, 2.5],
            "radius": 0.5,
            "emitter": {"type": "directionalarea", "radiance": {"type": "rgb", "value": [3, 4, 5]}},
        },
        "bitmap rectangle": lambda: {**RECTANGLE, "emitter": {"type": "directionalarea", "radiance": image()}},
    },
    "envmap": {
        "sun": {"type": "envmap", "filename": sky_file(12, 24, sun=200)},
        "turned": {
            "type": "envmap",
            "filename": sky_file(7, 5),
            "to_world": T().rotate(unit(1, 2, 3), 70),
            "scale": 0.6,
        },
        "mirrored": {"type": "envmap", "filename": sky_file(33, 64, sun=50), "to_world": T().scale([-1, 1, 1])},
    },
    "point": {
        "position": {"type": "point", "position": [-2, 3, 2.5], "intensity": {"type": "rgb", "value": [9, 8, 7]}},
        "turned": {"type": "point", "to_world": SPOT, "intensity": 12.0},
    },
    "projector": {
        "default": {"type": "projector", "to_world": SPOT},
        "colour": {
            "type": "projector",
            "to_world": TILTED,
            "fov": 60.0,
            "irradiance": {"type": "rgb", "value": [3, 2, 1]},
            "scale": 2.0,
        },
        "checkerboard": {
            "type": "projector",
            "to_world": SPOT,
            "focal_length": "35mm",
            "irradiance": COLOURS,
            "scale": 3.0,
        },
        "bitmap": lambda: {"type": "projector", "to_world": TILTED, "fov": 50.0, "irradiance": image()},
        "upright bitmap": lambda: {
            "type": "projector",
            "to_world": SPOT,
            "fov": 40.0,
            "fov_axis": "y",
            "irradiance": image(filter_type="nearest", wrap_mode="clamp"),
        },
        "mirrored bitmap": lambda: {"type": "projector", "to_world": MIRRORED, "irradiance": image()},
    },
    "spot": {
        "default": {"type": "spot", "to_world": SPOT, "intensity": 20.0},
        "turned": {
            "type": "spot",
            "to_world": TILTED,
            "cutoff_angle": 35.0,
            "beam_width": 5.0,
            "intensity": {"type": "rgb", "value": [9, 20, 15]},
        },
        "sharp": {"type": "spot", "to_world": SPOT, "cutoff_angle": 25.0, "beam_width": 25.0, "intensity": 20.0},
        "wide": {"type": "spot", "to_world": SPOT, "cutoff_angle": 90.0, "beam_width": 0.0, "intensity": 20.0},
        "large": {"type": "spot", "to_world": SPOT @ T().scale(3), "intensity": 20.0},
        "checkerboard": {
            "type": "spot",
            "to_world": TILTED,
            "cutoff_angle": 30.0,
            "intensity": 30.0,
            "texture": {**COLOURS, "to_uv": T().scale([3, 2, 1])},
        },
        "bitmap": lambda: {"type": "spot", "to_world": TILTED, "cutoff_angle": 30.0, "texture": image()},
        "mirrored bitmap": lambda: {"type": "spot", "to_world": MIRRORED, "intensity": 3.0, "texture": image()},
    },
    "sunsky": {
        "large sun": {"type": "sunsky", "sun_direction": [-1, 2, 1.5], "sun_aperture": 30.0, "to_world": UPRIGHT},
        "hazy": {
            "type": "sunsky",
            "sun_direction": [-2, 1, 2.5],
            "turbidity": 8.5,
            "albedo": {"type": "rgb", "value": [0.1, 0.5, 0.9]},
            "sun_aperture": 40.0,
            "complex_sun": True,
            "sky_scale": 2.0,
            "to_world": UPRIGHT,
        },
        "sky": {"type": "sunsky", "sun_direction": [-1, 1, 0.5], "sun_scale": 0.0, "to_world": UPRIGHT},
    },
}
"""The scene's entry by plugin and name of the set."""

UNLIKE_MITSUBA = {
    "area-turned bitmap rectangle": "Mitsuba 3.9.1 samples a bitmap as if it had no `to_uv`",
    "area-bitmap cylinder": "Mitsuba 3.9.1 finds some points of a tilted cylinder on the wall opposite",
    "area-bitmap cube": "Mitsuba 3.9.1 samples one face of a cube, since all have the same uv",
}
"""Sets that Mitsuba samples in another way, and why: see tests/lights/test_textured.py."""

RAYS_UNLIKE_MITSUBA = {
    "envmap-turned": "Mitsuba 3.9.1 doesn't turn the disks that rays start from with the emitter",
    "envmap-mirrored": "the same",
    "sunsky-large sun": "three of 12288 coordinates differ by 2e-4: the last bits of shares are stretched in the tails",
    "sunsky-hazy": "Mitsuba 3.9.1 computes the solid angle of the sun in single precision, 0.2 % off",
}
"""Sets whose rays, but not their directions, Mitsuba samples in another way."""

NAMES = [f"{plugin}-{name}" for plugin, sets in SETS.items() for name in sets]


def entry(name: str) -> dict[str, Any]:
    """The scene's entry for one of `NAMES`."""
    plugin, _, which = name.partition("-")
    found = SETS[plugin][which]
    return found() if callable(found) else found


def plugin_of(name: str) -> str:
    """The emitter plugin of one of `NAMES`."""
    return name.partition("-")[0]


def first_of_each(names: Iterable[str]) -> list[Any]:
    """Parameter sets as test parameters; all but the first of each plugin are marked as slow."""
    return slow_but_first(names, plugin_of)
