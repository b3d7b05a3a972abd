"""Scenes at any scale and place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt
from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["PLACED", "Place", "closed_room", "huge_sphere", "path"]

Description = dict[str, Any]


@dataclass(frozen=True)
class Place:
    """A map p -> scale (p + offset) from coordinates of unit size to the world."""

    scale: float = 1.0
    offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def to_world(self) -> T:
        """The map as a transform."""
        return T().translate((self.scale * self.offset).tolist()).scale(self.scale)

    def point(self, p: Any) -> list[float]:
        """A point in the world."""
        moved: list[float] = (self.scale * (np.array(p, float) + self.offset)).tolist()
        return moved

    def camera(self, origin: Any, target: Any, size: int = 24, spp: int = 32, **entries: Any) -> Description:
        """A camera; its directions are rounded as at the origin."""
        matrix = np.array(T().look_at(origin=list(origin), target=list(target), up=[0, 0, 1]).matrix)
        matrix[:3, 3] = self.point(origin)
        film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
        lengths = {"near_clip": 0.01 * self.scale, "far_clip": 1e4 * self.scale}
        sampler = {"type": "independent", "sample_count": spp}
        return {"type": "perspective", "fov": 40, "to_world": T(matrix), "film": film, "sampler": sampler} | (
            lengths | entries
        )

    def rectangle(self, center: Any, size: float = 1.0, turn: Any = None, **entries: Any) -> Description:
        """A square whose front points up; `turn` is (axis, angle)."""
        moved = self.to_world.translate(list(center))
        moved = moved if turn is None else moved.rotate(*turn)
        return {"type": "rectangle", "to_world": moved.scale([size, size, 1]), **entries}

    def ball(self, center: Any, radius: float = 1.0, **entries: Any) -> Description:
        """A sphere."""
        return {"type": "sphere", "to_world": self.to_world.translate(list(center)).scale(radius), **entries}


def diffuse(reflectance: float) -> Description:
    return {"type": "diffuse", "reflectance": reflectance}


def area(radiance: float) -> Description:
    return {"type": "area", "radiance": radiance}


def path(max_depth: int = 6) -> Description:
    return {"type": "path", "max_depth": max_depth}


DOWN = ([1, 0, 0], 180)
WALLS = {
    "floor": ((0, 0, -1), None),
    "ceiling": ((0, 0, 1), DOWN),
    "left": ((-1, 0, 0), ([0, 1, 0], 90)),
    "right": ((1, 0, 0), ([0, 1, 0], -90)),
    "back": ((0, 1, 0), ([1, 0, 0], 90)),
    "front": ((0, -1, 0), ([1, 0, 0], -90)),
}


def cube_mesh(to_world: T, bsdf: Description) -> djpt.Mesh:
    corners = np.array([[(i >> k) % 2 * 2 - 1 for k in range(3)] for i in range(8)], float)
    sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[a, b, c] for a, b, c, _ in sides] + [[a, c, d] for a, _, c, d in sides])
    return djpt.Mesh("mesh", corners, faces, props={"to_world": to_world, "bsdf": djpt.load_dict(bsdf)})


def closed_room(place: Place, walls: str) -> Description:
    """A room without a light in a bright sky, seen from inside: 128 x 128 pixels, 16 samples each."""
    white = {"type": "twosided", "bsdf": diffuse(0.7)}
    room: Description = {"room": {"type": "cube", "to_world": place.to_world, "bsdf": white}}
    if walls == "mesh":
        room = {"room": cube_mesh(place.to_world, white)}
    if walls == "rectangles":
        room = {name: place.rectangle(center, 1.0, turn, bsdf=white) for name, (center, turn) in WALLS.items()}
    camera = place.camera((0.3, -0.9, 0.2), (0, 0, 0), 128, 16, fov=90)
    sky = {"type": "constant", "radiance": 100.0}
    return {"type": "scene", "integrator": path(4), "sensor": camera, "sky": sky, **room}


def cornell(place: Place = Place()) -> Description:
    """A room with a box and a box of triangles."""
    white = diffuse(0.7)
    room = {
        name: place.rectangle(center, 1.0, turn, bsdf=white)
        for name, (center, turn) in WALLS.items()
        if name != "front"
    }
    tall = place.to_world.translate([-0.35, 0.3, -0.4]).rotate([0, 0, 1], 20).scale([0.3, 0.3, 0.6])
    low = place.to_world.translate([0.35, -0.3, -0.7]).rotate([0, 0, 1], -15).scale(0.3)
    return {
        "type": "scene",
        "integrator": path(),
        "sensor": place.camera((0, -3.9, 0), (0, 0, 0)),
        **room,
        "tall": {"type": "cube", "to_world": tall, "bsdf": white},
        "low": cube_mesh(low, white),
        "light": place.rectangle((0, 0, 0.99), 0.25, DOWN, emitter=area(10)),
    }


def balls(place: Place = Place(), **entries: Any) -> Description:
    """Two balls on a floor under a square lamp."""
    return {
        "type": "scene",
        "integrator": path(),
        "sensor": place.camera((0, -6, 2), (0, 0, 0.5)),
        "floor": place.rectangle((0, 0, 0), 6, bsdf=diffuse(0.5)),
        "ball": place.ball((-1.1, 0, 1), bsdf=diffuse(0.6)),
        "metal": place.ball((1.1, 0, 0.5), 0.5, bsdf={"type": "roughconductor", "alpha": 0.2}),
        "light": place.rectangle((0, 0, 4), 1, DOWN, emitter=area(8)),
    } | entries


def lamps(place: Place = Place()) -> Description:
    """Two balls lit by lamps without size, whose intensities are those of the scale."""
    scene, square = balls(place), place.scale**2
    del scene["light"]
    looking = np.array(T().look_at(origin=[2, -2, 4], target=[0, 0, 0], up=[0, 0, 1]).matrix)
    looking[:3, 3] = place.point((2, -2, 4))
    checks = {"type": "checkerboard", "to_uv": T().scale([4, 4, 1])}
    return scene | {
        "bulb": {"type": "point", "position": place.point((1, -2, 4)), "intensity": 10 * square},
        "spot": {"type": "spot", "to_world": T(looking), "intensity": 10 * square, "cutoff_angle": 30},
        "projector": {"type": "projector", "to_world": T(looking), "irradiance": checks, "scale": square, "fov": 40},
        "sun": {"type": "directional", "direction": [0.3, 0.2, -1], "irradiance": 0.2},
    }


def sky(place: Place = Place()) -> Description:
    """Two balls under a sky, seen through a lens."""
    lens = {"type": "thinlens", "aperture_radius": 0.1 * place.scale, "focus_distance": 6 * place.scale}
    scene = balls(place, sky={"type": "sunsky"}, sensor=place.camera((0, -6, 2), (0, 0, 0.5)) | lens)
    del scene["light"]
    return scene


def fog(place: Place = Place()) -> Description:
    """A ball of fog on a floor, which scatters once in its diameter."""
    medium = {"type": "homogeneous", "sigma_t": 0.5 / place.scale, "albedo": 0.8}
    ball = place.ball((-1.1, 0, 1), bsdf={"type": "null"}, interior=medium)
    return balls(place, ball=ball, integrator={"type": "volpath", "max_depth": 6})


def glow(place: Place = Place()) -> Description:
    """A ball of fog and a block of smoke that glow, on a floor, without another light."""
    red = {"type": "rgb", "value": [1.5 / place.scale, 0.6 / place.scale, 0.3 / place.scale]}
    fog = {"type": "homogeneous", "sigma_t": 0.5 / place.scale, "albedo": 0.4, "emission": red}
    heat = np.linspace(0, 2, 64, dtype=np.float32).reshape(4, 4, 4, 1)
    block = place.to_world.translate([0.4, -0.6, 0.1]).scale(1.4)
    grid = {"type": "gridvolume", "data": heat / np.float32(place.scale), "to_world": block}
    smoke = {"type": "heterogeneous", "sigma_t": grid, "albedo": 0.3, "emission": grid}
    seen_through = {"type": "null"}
    scene = balls(place, integrator={"type": "volpath", "max_depth": 4})
    del scene["metal"], scene["light"]
    return scene | {
        "ball": place.ball((-1.1, 0, 1), bsdf=seen_through, interior=fog),
        "cube": {
            "type": "cube",
            "to_world": block.translate([0.5, 0.5, 0.5]).scale(0.5),
            "bsdf": seen_through,
            "interior": smoke,
        },
    }


def lengths(place: Place = Place()) -> Description:
    """A ball of coloured glass on a floor with bumps, and one carved out of a block of colours.

    Absorption is per unit of length, heights are lengths, and volumes are looked up in the world.
    """
    height = {"type": "bitmap", "data": np.random.default_rng(3).random((8, 8, 1)), "raw": True}
    bumps = {"type": "bumpmap", "height": height, "scale": 3 * place.scale, "paint": diffuse(0.5)}
    green = {"type": "rgb", "value": [0.8 / place.scale, 0.2 / place.scale, 0.5 / place.scale]}
    colours = np.random.default_rng(4).random((4, 4, 4, 3), np.float32)
    block = {"type": "gridvolume", "data": colours, "to_world": place.to_world.translate([0.6, -0.5, 0])}
    carved = {"type": "diffuse", "reflectance": {"type": "volume", "volume": block}}
    return balls(place) | {
        "floor": place.rectangle((0, 0, 0), 6, bsdf=bumps),
        "metal": place.ball((1.1, 0, 0.5), 0.5, bsdf=carved),
        "ball": place.ball((-1.1, 0, 1), bsdf={"type": "dielectric", "absorption": green}),
    }


def instances(place: Place = Place()) -> Description:
    """Two instances of a group of a mesh and a ball."""
    group = {"type": "shapegroup", "m": cube_mesh(T().scale(0.5), diffuse(0.6)), "s": Place().ball((0, 0, 1), 0.5)}
    copies = {
        f"copy{i}": {
            "type": "instance",
            "to_world": place.to_world.translate([x, 0, 0.5]),
            "g": {"type": "ref", "id": "g"},
        }
        for i, x in enumerate((-1, 1))
    }
    scene = balls(place)
    del scene["ball"], scene["metal"]
    return scene | {"g": group, **copies}


def huge_sphere(place: Place = Place()) -> Description:
    """A ball on a sphere 10000 times as large, whose top is the origin, under a white sky."""
    return {
        "type": "scene",
        "integrator": path(),
        "sensor": place.camera((0, -6, 2), (0, 0, 0.5)),
        "ground": place.ball((0, 0, -1e4), 1e4, bsdf=diffuse(0.5)),
        "ball": place.ball((0, 0, 1), bsdf=diffuse(0.7)),
        "sky": {"type": "constant"},
    }


PLACED: dict[str, Callable[..., Description]] = {
    "cornell": cornell,
    "balls": balls,
    "lamps": lamps,
    "sky": sky,
    "fog": fog,
    "glow": glow,
    "lengths": lengths,
    "instances": instances,
    "huge sphere": huge_sphere,
}
"""Functions from a `Place` to a scene, by what is special about it."""
