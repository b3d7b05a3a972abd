"""Scenes with media: smoke over a fire, milk, a cold drink, sunbeams, candles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import djpt
from djpt import ScalarTransform4f as T
from places import IMAGES

__all__ = ["candles", "drink", "milk", "smoke", "subsurface", "subsurface_weights", "sunbeams"]

NULL = {"type": "null"}


def smoke() -> None:
    """A fire and its smoke."""
    draw("smoke", smoke_scene(), 256)


def milk() -> None:
    """A glass of milk."""
    draw("milk", milk_scene(), 256)


def drink() -> None:
    """A glass of water with ice and a straw."""
    draw("drink", drink_scene(), 1024)


def sunbeams() -> None:
    """A room with a window that the sun shines through."""
    draw("sunbeams", sunbeams_scene(), 2048)


def candles() -> None:
    """Wax of three colours, and flames."""
    draw("candles", candles_scene(), 256)


def subsurface() -> None:
    """Milk, marble, skin, and what has the colour of wax."""
    bodies = [
        djpt.subsurface(material="whole_milk", scale=0.2, roughness=0.1),
        djpt.subsurface(material="marble", scale=0.2, roughness=0.15),
        djpt.subsurface(material="skin_1", scale=0.2),
        djpt.subsurface([0.9, 0.62, 0.3], [1.0, 0.5, 0.25], scale=0.2),
    ]
    draw("subsurface", subsurface_scene(bodies), 2048)


def subsurface_weights() -> None:
    """The weights 0, 0.5 and 1 of one body, and one with a textured colour."""
    bodies = [djpt.subsurface([0.8, 0.5, 0.3], [1.0, 0.5, 0.25], scale=0.2, weight=weight) for weight in (0, 0.5, 1)]
    stripes = {
        "type": "checkerboard",
        "color0": colour(0.85, 0.6, 0.5),
        "color1": colour(0.5, 0.25, 0.2),
        "to_uv": T().scale([5, 3, 1]),
    }
    bodies.append(djpt.subsurface(stripes, [1.0, 0.5, 0.25], scale=0.2, interior_color=[0.7, 0.45, 0.35]))
    draw("subsurface_weights", subsurface_scene(bodies), 4096)


def draw(name: str, scene: dict[str, Any], spp: int) -> None:
    """Render a scene to its picture."""
    djpt.write(str(IMAGES / f"{name}.png"), djpt.render(djpt.load_dict(scene), spp=spp))


def seen(origin: list[float], target: list[float], fov: float, max_depth: int, size: int = 224) -> dict[str, Any]:
    """An empty scene with a camera."""
    return {
        "type": "scene",
        "integrator": {"type": "volpathmis", "max_depth": max_depth, "rr_depth": max_depth},
        "sensor": {
            "type": "perspective",
            "fov": fov,
            "to_world": T().look_at(origin=origin, target=target, up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size},
        },
    }


def colour(*value: float) -> dict[str, Any]:
    """A colour of a description."""
    return {"type": "rgb", "value": list(value)}


def matte(*value: float) -> dict[str, Any]:
    """A diffuse surface that has two sides."""
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour(*value)}}


def lamp(origin: list[float], target: list[float], size: float, *radiance: float) -> dict[str, Any]:
    """A square that shines at a point."""
    return {
        "type": "rectangle",
        "to_world": T().look_at(origin=origin, target=target, up=[0, 0, 1]).scale(size),
        "emitter": {"type": "area", "radiance": colour(*radiance)},
    }


def ground(y: float, *value: float) -> dict[str, Any]:
    """A wide floor."""
    return {
        "type": "rectangle",
        "to_world": T().translate([0, y, 0]).rotate([1, 0, 0], -90).scale(30),
        "bsdf": matte(*value),
    }


def dense(scene: dict[str, Any]) -> dict[str, Any]:
    """A scene as `seen` gives it, for bodies in which light is scattered for long."""
    scene["integrator"]["type"] = "volpathcache"
    scene["sensor"]["sampler"] = {"type": "sobol"}
    return scene


# ---------------------------------------------------------------- smoke


def noise(points: NDArray[np.float64], octaves: int, seed: int) -> NDArray[np.float64]:
    """Smooth noise about 0 at points (.., 3), halved in size and strength from octave to octave."""
    rng = np.random.default_rng(seed)
    total = np.zeros(points.shape[:-1])
    for octave in range(octaves):
        waves = rng.normal(size=(12, 3)) * 2.2 * 2**octave
        total += np.cos(points @ waves.T + rng.uniform(0, 2 * np.pi, 12)).sum(axis=-1) / (6 * 2**octave)
    return total


def plume() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smoke that rises and widens, and the fire below it: extinction and emission, (Z, Y, X, C), y upwards."""
    y, x, z = np.meshgrid(np.linspace(0, 1, 96), *[np.linspace(-1, 1, 64)] * 2, indexing="ij")
    turbulence = np.stack([x, 3 * y, z], axis=-1)
    sway_x, sway_z = (0.5 * y * noise(turbulence * 0.5, 2, seed) for seed in (1, 2))
    radius = np.sqrt((x - sway_x) ** 2 + (z - sway_z) ** 2) / (0.14 + 0.5 * y)
    ragged = radius + 0.45 * noise(turbulence * 1.5, 4, 3)
    density = np.clip(1.1 - ragged, 0, None) * np.clip(6 * (y - 0.12), 0, 1) * np.clip(4 * (1 - y), 0, 1)
    heat = np.clip(1 - 1.4 * ragged - 2.6 * y, 0, None)[..., None] * np.array([26.0, 8.0, 1.2])
    # Grids are stored with x fastest and z slowest.
    return tuple(np.ascontiguousarray(a.transpose(2, 0, 1, *range(3, a.ndim)), np.float32) for a in (density, heat))


def smoke_scene() -> dict[str, Any]:
    """A plume over a floor at dusk."""
    density, heat = plume()
    place = T().translate([-1, 0, -1]).scale([2, 3, 2])
    fire = {
        "type": "heterogeneous",
        "sigma_t": {"type": "gridvolume", "data": density, "to_world": place},
        "scale": 14.0,
        "albedo": colour(0.92, 0.92, 0.93),
        "emission": {"type": "gridvolume", "data": heat, "to_world": place},
        "phase": {"type": "hg", "g": 0.3},
    }
    return {
        **seen([0, 0.9, 7.2], [0, 1.42, 0], 27, 24),
        "sky": {"type": "constant", "radiance": colour(0.16, 0.2, 0.3)},
        "lamp": lamp([4, 5, 1], [0, 1.5, 0], 0.8, 40, 37, 34),
        "floor": ground(0, 0.35, 0.33, 0.3),
        "air": {
            "type": "cube",
            "to_world": place @ T().translate([0.5] * 3).scale(0.505),
            "bsdf": NULL,
            "interior": fire,
        },
    }


# ---------------------------------------------------------------- milk


def turned(profile: list[tuple[float, float]], name: str, steps: int = 96, **props: Any) -> djpt.Mesh:
    """The surface that a line of points (radius, y) sweeps about the y axis; its outside is on the line's right."""
    angle = np.arange(steps) / steps * 2 * np.pi
    rings = [np.stack([r * np.cos(angle), np.full(steps, y), r * np.sin(angle)], axis=-1) for r, y in profile]
    first = np.arange(steps)
    after = (first + 1) % steps
    faces = []
    for k in range(len(profile) - 1):
        low, high = k * steps, (k + 1) * steps
        faces.append(np.stack([low + first, high + first, high + after], axis=1))
        faces.append(np.stack([low + first, high + after, low + after], axis=1))
    return djpt.Mesh(name, vertex_positions=np.concatenate(rings), faces=np.concatenate(faces), props=props)


def milk_scene() -> dict[str, Any]:
    """A glass, two thirds full. Where two bodies touch, one surface stands for both."""
    outer, inner, height, bottom, level, tip = 0.5, 0.45, 1.6, 0.12, 1.1, 1e-3
    white = {
        "type": "homogeneous",
        "sigma_t": colour(24, 26, 30),
        "albedo": colour(0.9995, 0.9985, 0.994),
        "asymmetry": 0.7,
    }

    def interface(inside: float, outside: float) -> dict[str, Any]:
        return {"type": "dielectric", "int_ior": inside, "ext_ior": outside}

    rim = [(outer, height - 0.02), (outer - 0.015, height), (inner + 0.015, height), (inner, height - 0.02)]
    glass = [(tip, 0.0), (outer - 0.02, 0.0), (outer, 0.02), *rim, (inner, level)]
    filled = [(tip, bottom), (inner - 0.03, bottom), (inner, bottom + 0.03), (inner, level)]
    surface = [(inner, level), (tip, level)]
    liquid: dict[str, Any] = {"interior": white}
    return {
        **dense(seen([0, 2.1, 5.5], [0, 0.75, 0], 25, 256)),
        "sky": {"type": "constant", "radiance": colour(0.5, 0.55, 0.62)},
        "lamp": lamp([4, 4.5, 2], [0, 0.8, 0], 3.5, 2.2, 2.1, 1.9),
        "table": ground(-0.01, 0.32, 0.2, 0.12),
        "glass": turned(glass, "glass", bsdf=interface(1.5, 1.0)),
        "filled": turned(filled, "filled", bsdf=interface(1.35, 1.5), **liquid),
        "surface": turned(surface, "surface", bsdf=interface(1.35, 1.0), **liquid),
    }


# ---------------------------------------------------------------- a drink


def drink_scene() -> dict[str, Any]:
    """Water that reaches into the wall of its glass, and into ice."""
    outer, inner, height, bottom, level = 0.5, 0.44, 1.5, 0.12, 1.05

    def body(ior: str | float, priority: float, *absorption: float) -> dict[str, Any]:
        bsdf = {"type": "dielectric", "int_ior": ior, "absorption": colour(*absorption)}
        return {"bsdf": bsdf, "priority": priority}

    rim = [(outer, height - 0.02), (outer - 0.02, height), (inner + 0.02, height), (inner, height - 0.02)]
    inside = [(inner, bottom + 0.06), (inner - 0.06, bottom), (0.0, bottom)]
    glass = [(0.0, 0.0), (outer - 0.03, 0.0), (outer, 0.03), *rim, *inside]
    middle = (inner + outer) / 2
    water = [(0.0, bottom - 0.03), (middle, bottom - 0.03), (middle, level), (0.0, level)]
    cubes = [([-0.16, 0.98, 0.1], 20, 35), ([0.17, 0.96, -0.08], 65, 50), ([-0.05, 0.97, -0.27], 40, 15)]
    ice = {
        f"ice_{k}": {
            "type": "cube",
            "to_world": T().translate(place).rotate([0, 1, 0], turn).rotate([1, 0, 0], tilt).scale(0.13),
            **body("water ice", 1.0, 0.05, 0.03, 0.02),
        }
        for k, (place, turn, tilt) in enumerate(cubes)
    }
    straw = T().look_at(origin=[0.28, 0.2, 0.1], target=[-0.75, 2.05, 0.05], up=[0, 0, 1])
    return {
        **seen([0, 1.7, 5.2], [0, 0.74, 0], 25, 64),
        "sky": {"type": "constant", "radiance": colour(0.75, 0.8, 0.88)},
        "lamp": lamp([4, 4.5, 2], [0, 0.8, 0], 3.0, 3.0, 2.8, 2.5),
        "table": ground(-0.01, 0.36, 0.25, 0.16),
        "glass": turned(glass, "glass", 512, **body(1.5, 2.0, 0.5, 0.15, 0.3)),
        "water": turned(water, "water", 512, **body("water", 0.0, 0.35, 0.06, 0.04)),
        **ice,
        "straw": {
            "type": "cylinder",
            "p0": [0, 0, 0],
            "p1": [0, 0, 2.1],
            "radius": 0.045,
            "to_world": straw,
            "bsdf": matte(0.75, 0.1, 0.08),
        },
    }


# ---------------------------------------------------------------- sunbeams


def board(low: list[float], high: list[float], *value: float) -> dict[str, Any]:
    """A box along the axes."""
    low_, high_ = np.array(low), np.array(high)
    place = T().translate(((low_ + high_) / 2).tolist()).scale(((high_ - low_) / 2).tolist())
    return {"type": "cube", "to_world": place, "bsdf": {"type": "diffuse", "reflectance": colour(*value)}}


def sunbeams_scene() -> dict[str, Any]:
    """A dusty room: its left wall has a window with bars."""
    dust = {"type": "homogeneous", "sigma_t": 0.18, "albedo": 0.95, "phase": {"type": "hg", "g": 0.5}}
    white, wood = (0.7, 0.68, 0.64), (0.28, 0.18, 0.11)
    low, high, left, right = 1.0, 2.3, -0.9, 0.9
    wall = {
        "below": board([-2.2, 0, -2], [-2.0, low, 2], *white),
        "above": board([-2.2, high, -2], [-2.0, 3, 2], *white),
        "behind": board([-2.2, low, -2], [-2.0, high, left], *white),
        "before": board([-2.2, low, right], [-2.0, high, 2], *white),
    }
    bars = {
        f"bar_{k}": board([-2.14, low, z - 0.06], [-2.06, high, z + 0.06], *wood) for k, z in enumerate((-0.3, 0.3))
    }
    return {
        **seen([1.0, 1.5, 6.2], [-0.25, 1.4, 0], 40, 16),
        "sun": {"type": "directional", "direction": [1.0, -0.62, 0.12], "irradiance": colour(40, 33, 23)},
        "outside": {
            "type": "rectangle",
            "to_world": T().translate([-6, 1, 0]).rotate([0, 1, 0], 90).scale([4, 2, 1]),
            "emitter": {"type": "area", "radiance": colour(1.0, 1.3, 1.8)},
        },
        **wall,
        **bars,
        "crossbar": board([-2.14, 1.59, left], [-2.06, 1.71, right], *wood),
        "floor": board([-2.2, -0.2, -2.2], [2.2, 0, 2], 0.45, 0.3, 0.2),
        "ceiling": board([-2.2, 3, -2.2], [2.2, 3.2, 2], *white),
        "back": board([-2.2, 0, -2.2], [2.2, 3, -2], 0.5, 0.52, 0.5),
        "right": board([2, 0, -2], [2.2, 3, 2], *white),
        "air": {
            "type": "cube",
            "to_world": T().translate([0, 1.5, 0]).scale([1.99, 1.49, 1.99]),
            "bsdf": NULL,
            "interior": dust,
        },
    }


# ---------------------------------------------------------------- candles


def candle(x: float, z: float, height: float, *albedo: float) -> dict[str, Any]:
    """A candle of one colour and its flame."""
    wax = {"type": "homogeneous", "sigma_t": 28.0, "albedo": colour(*albedo), "asymmetry": 0.3}
    glow = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.0, "emission": colour(160, 75, 22)}
    profile = [(1e-3, 0.0), (0.3, 0.0), (0.3, height - 0.03), (0.27, height), (1e-3, height - 0.03)]
    flame = [(1e-3, height + 0.02), (0.04, height + 0.06), (0.055, height + 0.12), (0.03, height + 0.24)]
    flame.append((1e-3, height + 0.34))
    name = f"candle_{round(100 * x)}"
    return {
        name: turned(profile, name, bsdf=NULL, interior=wax, to_world=T().translate([x, 0, z])),
        f"{name}_flame": turned(flame, f"{name}_flame", bsdf=NULL, interior=glow, to_world=T().translate([x, 0, z])),
    }


def candles_scene() -> dict[str, Any]:
    """Three candles in a dim room."""
    return {
        **dense(seen([0, 1.5, 5.6], [0, 0.62, 0], 27, 256)),
        "sky": {"type": "constant", "radiance": colour(0.05, 0.06, 0.09)},
        "lamp": lamp([-3, 4, 3], [0, 0.5, 0], 0.8, 9, 9, 10),
        "table": ground(-0.01, 0.3, 0.27, 0.25),
        **candle(-0.85, 0.0, 0.7, 0.995, 0.75, 0.6),
        **candle(0.0, -0.3, 1.05, 0.8, 0.985, 0.75),
        **candle(0.85, 0.1, 0.5, 0.7, 0.8, 0.995),
    }


# ---------------------------------------------------------------- subsurface


def subsurface_scene(bodies: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Balls, 1 cm wide, with a lamp beside and behind them; the scene's unit is 5 mm."""
    scene = seen([0, 2.6, 12.0], [0, 0.75, 0], 40, 256)
    scene["sensor"]["film"].update(width=448, height=140)
    return {
        **scene,
        "sky": {"type": "constant", "radiance": colour(0.25, 0.28, 0.34)},
        "lamp": lamp([6, 6, -3], [0, 1, 0], 2.2, 16, 15, 13),
        "table": ground(-0.01, 0.3, 0.27, 0.25),
        **{
            f"ball_{k}": {"type": "sphere", "center": [2.3 * k - 3.45, 1.0, 0.0], **body}
            for k, body in enumerate(bodies)
        },
    }
