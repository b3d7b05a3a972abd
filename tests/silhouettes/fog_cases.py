"""Cases of cameras that move in media, or look into them, whose derivatives central differences check."""

from __future__ import annotations

from typing import Any

import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import TensorXf
from tests.silhouettes.camera_cases import GROUND, MOTIONS, orbit, with_filter
from tests.silhouettes.cases import SIZE, Case, ball, edit, sensor, shift, sky, turn_head
from tests.silhouettes.test_projective import globe

FOG = {
    "type": "homogeneous",
    "albedo": 0.8,
    "sigma_t": {"type": "rgb", "value": [0.08, 0.1, 0.15]},
    "phase": {"type": "hg", "g": 0.4},
}
LAMP = {"type": "sphere", "center": [2, 2, 3], "radius": 0.5, "emitter": {"type": "area", "radiance": 40.0}}
LIGHT = {"type": "point", "position": [1, 2, 4], "intensity": 40.0}
BODY = ball({"type": "roughconductor", "alpha": 0.3}, center=[0.5, 0.2, 0], radius=0.8)
DENSITY = TensorXf(0.2 + np.random.default_rng(3).random((3, 4, 5, 1)).astype(np.float32))


def everywhere(medium: dict[str, Any] = FOG) -> dict[str, Any]:
    """A medium that fills a box, with the camera within."""
    return {"type": "cube", "to_world": T().scale(8), "bsdf": {"type": "null"}, "interior": medium}


def cloud(kind: str, medium: dict[str, Any]) -> dict[str, Any]:
    """A body of a medium in front of the camera."""
    place = T().translate([-0.3, 0.1, 0.5]).rotate([0, 1, 0], 30).scale(0.9)
    return {"type": kind, "to_world": place, "bsdf": {"type": "null"}, "interior": medium}


def smoke() -> dict[str, Any]:
    """A cloud of a grid of densities."""
    body = cloud("cube", {})
    grid = {
        "type": "gridvolume",
        "data": DENSITY,
        "raw": True,
        "to_world": body["to_world"].translate([-1, -1, -1]).scale(2),
    }
    body["interior"] = {"type": "heterogeneous", "albedo": 0.7, "sigma_t": grid, "scale": 1.5}
    return body


def room(fog: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A ball over a floor under a lamp, with a medium."""
    return {"ball": BODY, "floor": GROUND, "lamp": LAMP, "fog": fog, **more}


CASES: dict[str, Case] = {
    f"a camera in fog, {motion}": Case(
        lambda: room(everywhere()),
        move,
        ("volpath",),
        depth=3,
        spp=4096 if motion in ("step back", "field of view") else 1024,
        spp_difference=16384,
        by="volpath",
    )
    for motion, move in MOTIONS.items()
}
CASES["a camera, orbit: a coloured cloud"] = Case(
    lambda: room(cloud("sphere", {**FOG, "scale": 8.0})),
    orbit,
    ("volpath", "volpathmis"),
    depth=4,
    spp=1024,
    spp_difference=8192,
    by="volpath",
)
CASES["a camera, step aside: smoke under a sky"] = Case(
    lambda: {"fog": smoke(), "floor": GROUND, "sky": sky()},
    shift("sensor.to_world"),
    ("prbvolpath",),
    depth=3,
    spp=1024,
    spp_difference=8192,
    by="volpath",
)
CASES["a camera in fog, orbit: a smooth mesh"] = Case(
    lambda: {"globe": globe(), "light": LIGHT, "fog": everywhere()},
    orbit,
    ("volpath",),
    spp=2048,
    spp_difference=16384,
    by="volpath",
)
CASES["a camera in fog, turn: a coarse smooth mesh over a bitmap"] = Case(
    lambda: {
        "globe": globe(6, 12),
        "floor": GROUND,
        "light": LIGHT,
        "fog": everywhere(),
    },
    turn_head,
    ("volpath",),
    spp=2048,
    spp_difference=16384,
    by="volpath",
)
for name, move in {"step aside": shift("sensor.to_world"), "aperture": edit("sensor.aperture_radius", 0.5)}.items():
    CASES[f"a lens in fog, {name}"] = Case(
        lambda: room(everywhere(), sensor=sensor(type="thinlens", aperture_radius=0.4, focus_distance=5.0)),
        move,
        ("volpath",),
        spp=2048,
        spp_difference=16384,
        by="volpath",
    )
CASES["an orthographic camera in fog, step aside"] = Case(
    lambda: room(
        everywhere(),
        sensor={
            "type": "orthographic",
            "to_world": T().look_at([1, 0.5, 6], [0, 0, 0], [0, 1, 0]).scale([1.2, 1.2, 1]),
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "pixel_format": "rgb"},
        },
    ),
    shift("sensor.to_world"),
    ("volpath",),
    spp=1024,
    spp_difference=8192,
    by="volpath",
)
CASES["a camera without media, by volpath"] = Case(
    lambda: {"ball": BODY, "floor": GROUND, "lamp": LAMP}, turn_head, ("volpath",), spp=1024, by="volpath"
)
for filtered in ("gaussian", "tent", "mitchell"):
    CASES[f"a camera in fog and a {filtered} filter"] = Case(
        lambda filtered=filtered: room(everywhere(), sensor=with_filter(filtered)),
        MOTIONS["turn"],
        ("volpath",),
        depth=2,
        spp=1024,
        spp_difference=8192,
        by="volpath",
    )
