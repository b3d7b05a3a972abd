"""The problems of `inverse.py`: what is unknown, what is seen of it, and how Mitsuba and djpt set out to find it."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

T = djpt.ScalarTransform4f


@dataclass(frozen=True)
class Problem:
    """What is unknown, and what is seen of it."""

    name: str
    about: str
    scene: Callable[[int], dict[str, Any]]
    """The description, with the true values, for a size of the picture."""
    truth: np.ndarray
    start: np.ndarray
    apply: Callable[[Any, Any, Any], None]
    """Set the parameters of a renderer's scene from the unknowns: (module, parameters, array or tensor)."""
    kind: str
    """The type of the unknowns: ``TensorXf`` or ``Float``."""
    rates: tuple[float, float, float]
    """Mitsuba's learning rates."""
    bounds: tuple[float, float]
    method: str
    """``gauss_newton`` or ``least_squares``."""
    keys: tuple[str, ...] = ()
    """For ``gauss_newton``: the parameters that the unknowns are, in their order."""
    spp: int = 8
    coarse: int = 0
    """For ``least_squares``: how often the picture is halved at first."""
    differences: float = 0.0
    """For ``least_squares``: the distance over which images are compared; 0: derivatives."""
    frozen: bool = False
    """For ``least_squares``: whether images and derivatives are traced once."""
    spp_divisor: int = 1
    """For ``least_squares``: by what the samples per pixel are divided, of which more images are averaged then."""
    spp_derivatives: int = 0
    """For ``least_squares``: the samples per pixel of derivatives, where these have more noise; 0: as images."""
    views: int = 1
    """The number of sensors whose pictures are compared."""
    seen: Callable[[np.ndarray], np.ndarray] = np.asarray
    """What is compared with that of the truth."""
    uniform: bool = False
    """Whether Adam's steps are divided by the largest gradient, as large steps on meshes need."""
    iterations: int = 60
    """The most steps of djpt."""
    steps: int = 2000
    """The most steps of Adam; it is given up after some seconds as well."""
    size: int = 64


def film(size: int) -> dict[str, Any]:
    """A square film with the box filter."""
    return {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}


def camera(size: int, origin: list[float], target: list[float], fov: float) -> dict[str, Any]:
    """A perspective camera, z up."""
    return {"type": "perspective", "fov": fov, "film": film(size), "to_world": T().look_at(origin, target, [0, 0, 1])}


def lamp(height: float, radiance: float, x: float = 0.0) -> dict[str, Any]:
    """A square lamp that shines down."""
    to_world = T().translate([x, 0, height]).rotate([1, 0, 0], 180).scale(0.5)
    return {"type": "rectangle", "to_world": to_world, "emitter": {"type": "area", "radiance": radiance}}


PAINTS = tuple(f"{name}.reflectance.value" for name in ("red", "green", "white"))


def cornell(size: int) -> dict[str, Any]:
    """The Cornell box."""
    scene: dict[str, Any] = djpt.cornell_box()
    scene["integrator"] = {"type": "prb", "max_depth": 6}
    scene["sensor"]["film"] = film(size)
    return scene


def apply_paints(module: Any, params: Any, x: Any) -> None:
    """The colours of the walls and boxes."""
    for i, key in enumerate(PAINTS):
        params[key] = module.Color3f(*(dr.gather(module.Float, x.array, module.UInt32(3 * i + c)) for c in range(3)))


def paints() -> Problem:
    """The paints of the Cornell box."""
    truth = np.array([[0.57, 0.043, 0.044], [0.105, 0.378, 0.076], [0.885, 0.698, 0.667]], np.float32)
    about = "Three colours of walls and boxes, from one picture. Light is reflected up to five times."
    start = np.full((3, 3), 0.5, np.float32)
    return Problem(
        "paints of the Cornell box",
        about,
        cornell,
        truth,
        start,
        apply_paints,
        "TensorXf",
        (0.02, 0.05, 0.1),
        (0.0, 1.0),
        "least_squares",
        frozen=True,
        spp_divisor=2,
        spp=16,
    )


TEXELS = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 3)).astype(np.float32)


def textured(size: int) -> dict[str, Any]:
    """A textured floor with two balls under a lamp."""
    paint = {"type": "bitmap", "data": TEXELS, "raw": True, "filter_type": "bilinear"}
    grey = {"type": "diffuse", "reflectance": 0.5}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 4},
        "sensor": camera(size, [0, -1.0, 2.4], [0, 0, 0], 50),
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": paint}},
        "lamp": lamp(2.5, 12.0),
        "left": {"type": "sphere", "center": [-0.5, 0.2, 0.4], "radius": 0.12, "bsdf": grey},
        "right": {"type": "sphere", "center": [0.5, 0.2, 0.4], "radius": 0.12, "bsdf": grey},
    }


TEXTURE = "floor.bsdf.reflectance.data"


def apply_texture(module: Any, params: Any, x: Any) -> None:
    """The texels of the floor."""
    params[TEXTURE] = x


def texture() -> Problem:
    """A texture of 16 x 16 texels."""
    return Problem(
        "texture",
        "16 x 16 texels of three channels on a floor with two balls, from one picture; the balls hide some.",
        textured,
        TEXELS,
        np.full_like(TEXELS, 0.5),
        apply_texture,
        "TensorXf",
        (0.05, 0.1, 0.2),
        (0.0, 1.0),
        "gauss_newton",
        keys=(TEXTURE,),
        spp=16,
    )


def sky() -> np.ndarray:
    """A sky of 8 x 16 texels: blue above, dark below, and a bright spot."""
    rows, columns = np.mgrid[0:8, 0:16]
    up = np.clip(1 - rows / 5, 0.05, 1)[..., None] * np.array([0.5, 0.7, 1.0])
    spot = 4 * np.exp(-((rows - 1.5) ** 2 + (columns - 6) ** 2) / 1.5)[..., None] * np.array([1.0, 0.8, 0.6])
    return np.asarray(up + spot, np.float32)


SKY = sky()


def ball_under_sky(size: int) -> dict[str, Any]:
    """A rough metal ball that reflects an environment."""
    metal = {"type": "roughconductor", "material": "none", "alpha": 0.15, "distribution": "ggx"}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sensor": camera(size, [0, -4, 0.8], [0, 0, 0], 28),
        "ball": {"type": "sphere", "bsdf": metal},
        "sky": {"type": "envmap", "bitmap": SKY, "to_world": T().rotate([1, 0, 0], 90)},
    }


def apply_sky(module: Any, params: Any, x: Any) -> None:
    """The texels of the sky, and what each renderer keeps beside them."""
    width = SKY.shape[1]
    stored = params["sky.data"].shape
    index = dr.arange(module.UInt32, int(np.prod(stored)))
    channel, pixel = index % stored[2], index // stored[2]
    row, column = pixel // stored[1], pixel % stored[1]
    source = row * width + (column + width - 1) % width  # the last column stands before the first as well
    params["sky.data"] = module.TensorXf(dr.gather(module.Float, x.array, 3 * source + channel), stored)


def environment() -> Problem:
    """An environment map, seen in a rough metal ball."""
    return Problem(
        "environment map from a ball",
        "8 x 16 texels of a sky, as a rough metal ball reflects it.",
        ball_under_sky,
        SKY,
        np.full_like(SKY, 0.5),
        apply_sky,
        "TensorXf",
        (0.02, 0.05, 0.1),
        (0.0, 20.0),
        "least_squares",
        frozen=True,
        spp=16,
        spp_divisor=2,
        iterations=24,
    )


PLACE = np.array([0.25, -0.2, 0.55], np.float32)


def ball_on_floor(size: int) -> dict[str, Any]:
    """A ball over a floor, at the origin before it is moved."""
    return {
        "type": "scene",
        # As in Mitsuba's tutorial of object poses: shadows that move have no derivatives, which take most of the time.
        "integrator": {"type": "direct_projective", "sppi": 0},
        "sensor": camera(size, [0, -3, 2.5], [0, 0, 0.3], 45),
        "floor": {"type": "rectangle", "to_world": T().scale(3), "bsdf": {"type": "diffuse", "reflectance": 0.5}},
        "sky": {"type": "constant", "radiance": 0.5},
        "light": {"type": "point", "position": [1, -2, 3], "intensity": 20.0},
        "ball": {"type": "sphere", "radius": 0.4, "bsdf": {"type": "diffuse", "reflectance": 0.15}},
    }


def apply_place(module: Any, params: Any, x: Any) -> None:
    """The way of the ball."""
    place = [dr.gather(module.Float, x, module.UInt32(i)) for i in range(3)]
    params["ball.to_world"] = module.Transform4f().translate(place)


def pose() -> Problem:
    """The place of a ball."""
    return Problem(
        "object pose",
        "The place of a ball over a floor, three numbers, from its outline and its shading.",
        ball_on_floor,
        PLACE,
        np.array([-0.1, 0.1, 0.4], np.float32),
        apply_place,
        "Float",
        (0.01, 0.02, 0.05),
        (-2.0, 2.0),
        "least_squares",
        spp_divisor=4,
        spp=16,
        coarse=3,
        differences=0.15,
        iterations=12,
    )


ROUGHNESS = np.random.default_rng(2).uniform(0.15, 0.7, (4, 4, 1)).astype(np.float32)
ROUGH = "body.bsdf.roughness.data"


def rough_plate(size: int) -> dict[str, Any]:
    """A metal plate of varying roughness under lamps."""
    rough = {"type": "bitmap", "data": ROUGHNESS, "raw": True, "filter_type": "bilinear"}
    metal = {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.7, 0.5]}, "metallic": 0.9}
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sensor": camera(size, [0, -2.2, 2.2], [0, 0, 0], 42),
        "body": {"type": "rectangle", "bsdf": {**metal, "roughness": rough}},
        "lamp": {
            "type": "rectangle",
            "to_world": T().look_at([0, 2.5, 2.5], [0, 0, 0], [0, 0, 1]).scale(0.7),
            "emitter": {"type": "area", "radiance": 8.0},
        },
        "sky": {"type": "constant", "radiance": 0.2},
    }


def apply_roughness(module: Any, params: Any, x: Any) -> None:
    """The roughness of the plate."""
    params[ROUGH] = x


def roughness() -> Problem:
    """The roughness of a principled body."""
    return Problem(
        "roughness of a principled body",
        "4 x 4 texels of roughness of a metal plate, from the reflection of a lamp. Rougher texels are brighter here "
        "and darker there.",
        rough_plate,
        ROUGHNESS,
        np.full_like(ROUGHNESS, 0.4),
        apply_roughness,
        "TensorXf",
        (0.01, 0.03, 0.06),
        (0.05, 1.0),
        "least_squares",
        frozen=True,
        spp_divisor=2,
        spp=16,
    )


SLOPES = np.random.default_rng(4).uniform(-0.4, 0.4, (4, 4, 2)).astype(np.float32)
NORMALS = "body.bsdf.normalmap.data"


def bumpy_plate(size: int) -> dict[str, Any]:
    """A principled plate with a normal map under lamps of three colours."""
    flat = {"type": "bitmap", "data": np.full((4, 4, 3), 0.5, np.float32), "raw": True, "filter_type": "bilinear"}
    paint = {"type": "principled", "base_color": {"type": "rgb", "value": [0.6, 0.6, 0.6]}, "roughness": 0.6}

    def coloured(origin: list[float], radiance: list[float]) -> dict[str, Any]:
        to_world = T().look_at(origin, [0, 0, 0], [0, 0.1, 1]).scale(0.3)
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
        return {"type": "rectangle", "to_world": to_world, "emitter": emitter}

    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2},
        "sensor": camera(size, [0, -0.5, 3], [0, 0, 0], 42),
        "body": {"type": "rectangle", "bsdf": {"type": "normalmap", "normalmap": flat, "bsdf": paint}},
        "one": coloured([2, 0, 2], [30, 2, 2]),
        "two": coloured([-1, 1.7, 2], [2, 30, 2]),
        "three": coloured([-1, -1.7, 2], [2, 2, 30]),
    }


def apply_slopes(module: Any, params: Any, x: Any) -> None:
    """The normals of the plate, from its slopes."""
    index = dr.arange(module.UInt32, 48)
    texel, axis = index // 3, index % 3
    u, v = (dr.gather(module.Float, x.array, 2 * texel + k) for k in (0, 1))
    component = dr.select(axis == 0, u, dr.select(axis == 1, v, 1)) * dr.rsqrt(1 + u * u + v * v)
    params[NORMALS] = module.TensorXf(0.5 + 0.5 * component, (4, 4, 3))


def normals() -> Problem:
    """The normal map of a principled body."""
    return Problem(
        "normal map of a principled body",
        "4 x 4 texels of a normal map, two slopes each, under lamps of three colours.",
        bumpy_plate,
        SLOPES,
        np.zeros_like(SLOPES),
        apply_slopes,
        "TensorXf",
        (0.02, 0.05, 0.1),
        (-1.0, 1.0),
        "least_squares",
        frozen=True,
        spp_divisor=2,
        spp=16,
        iterations=12,
    )


SHEEN = np.array([0.8, 0.45, 0.2, 0.3, 0.7], np.float32)


def material_ball(size: int) -> dict[str, Any]:
    """A principled ball under a sky."""
    scene = ball_under_sky(size)
    colour = {"type": "rgb", "value": [0.5, 0.5, 0.5]}
    scene["ball"]["bsdf"] = {"type": "principled", "base_color": colour, "roughness": 0.5, "metallic": 0.5}
    return scene


def apply_material(module: Any, params: Any, x: Any) -> None:
    """Colour, roughness and metallic of the ball."""
    a = [dr.gather(module.Float, x.array, module.UInt32(i)) for i in range(5)]
    params["ball.bsdf.base_color.value"] = module.Color3f(*a[:3])
    params["ball.bsdf.roughness.value"] = a[3]
    params["ball.bsdf.metallic.value"] = a[4]


def material() -> Problem:
    """A material fitted by `principled`."""
    return Problem(
        "material of a ball, fitted by principled",
        "Colour, roughness and metallic, five numbers, from a picture under a sky.",
        material_ball,
        SHEEN,
        np.full_like(SHEEN, 0.5),
        apply_material,
        "TensorXf",
        (0.01, 0.03, 0.06),
        (0.05, 1.0),
        "least_squares",
        frozen=True,
        spp_divisor=4,
        spp=16,
        differences=0.1,
        iterations=16,
    )


VIEW = np.array([0.35, -0.2, 0.25, 0.2, -0.15, 0.15], np.float32)
PATTERN = np.random.default_rng(4).uniform(0.1, 0.9, (12, 12, 3)).astype(np.float32)


def looked_at(size: int) -> dict[str, Any]:
    """Balls on a painted floor, for a camera that moves."""
    paint = {"type": "bitmap", "data": PATTERN, "raw": True, "filter_type": "bilinear"}
    placed = [(0.8, 0.3, 0.6, [0.8, 0.2, 0.1]), (-0.7, 0.8, 0.45, [0.1, 0.3, 0.8]), (-0.2, -0.9, 0.7, [0.8, 0.7, 0.2])]
    balls = {
        f"ball{k}": {
            "type": "sphere",
            "center": [x, y, radius],
            "radius": radius,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}},
        }
        for k, (x, y, radius, colour) in enumerate(placed)
    }
    return {
        "type": "scene",
        "integrator": {"type": "direct_projective", "sppi": 0},
        "sensor": {"type": "perspective", "fov": 38, "film": film(size)},
        "floor": {"type": "rectangle", "to_world": T().scale(2.2), "bsdf": {"type": "diffuse", "reflectance": paint}},
        "sky": {"type": "constant", "radiance": 0.5},
        "light": {"type": "point", "position": [2.0, -1.0, 5.0], "intensity": 30.0},
        **balls,
    }


def apply_view(module: Any, params: Any, x: Any) -> None:
    """Turn the camera about the scene by two angles, about its own axis by one, and move it by three lengths."""
    a = [dr.gather(module.Float, x, module.UInt32(i)) for i in range(6)]
    turned = module.Transform4f().translate([0, 0, 0.4])
    turned = turned.rotate([0, 0, 1], 40 + a[0] * (180 / math.pi)).rotate([0, 1, 0], -30 + a[1] * (180 / math.pi))
    looking = module.Transform4f().look_at([7, 0, 0], [0, 0, 0], [0, 0, 1])
    moved = turned @ looking.rotate([0, 0, 1], a[2] * (180 / math.pi)).translate([a[3], a[4], 3 * a[5]])
    params["sensor.to_world"] = moved


def view() -> Problem:
    """The pose of a camera."""
    return Problem(
        "camera pose",
        "Where a camera was, six numbers: two angles about the scene, one about its own axis, and three lengths.",
        looked_at,
        VIEW,
        np.zeros_like(VIEW),
        apply_view,
        "Float",
        (0.01, 0.02, 0.05),
        (-1.0, 1.0),
        "least_squares",
        spp_divisor=4,
        spp=16,
        coarse=3,
        differences=0.1,
        iterations=16,
    )


SMOKE = np.random.default_rng(3).uniform(0.1, 1.2, (4, 4, 4, 1)).astype(np.float32)
DENSITY = "body.interior_medium.sigma_t.data"


def smoke(size: int) -> dict[str, Any]:
    """A cloud before a bright sky with a lamp, seen from four sides."""
    grid = {"type": "gridvolume", "data": SMOKE, "to_world": T().translate([-1, -1, -1]).scale(2)}
    views = {
        f"view{k}": {
            "type": "perspective",
            "fov": 40,
            "film": film(size),
            "to_world": T().look_at([4.2 * math.cos(a), 4.2 * math.sin(a), 1.5 - k], [0, 0, 0], [0, 0, 1]),
        }
        for k, a in enumerate(np.linspace(0.3, 0.3 + 1.5 * math.pi, 4).tolist())
    }
    return {
        "type": "scene",
        "integrator": {"type": "prbvolpath", "max_depth": 4, "rr_depth": 10},
        "sensor": {"type": "batch", "film": {**film(size), "width": 4 * size}, **views},
        "body": {
            "type": "cube",
            "bsdf": {"type": "null"},
            "interior": {"type": "heterogeneous", "albedo": 0.6, "sigma_t": grid, "scale": 1.0},
        },
        "sky": {"type": "constant", "radiance": 0.5},
        "light": {"type": "point", "position": [2, -2, 3], "intensity": 30.0},
    }


def apply_smoke(module: Any, params: Any, x: Any) -> None:
    """The density of the smoke."""
    params[DENSITY] = x


def volume() -> Problem:
    """The density of a volume."""
    return Problem(
        "volume density",
        "4 x 4 x 4 densities of a cloud, from four sides. Light is scattered up to three times.",
        smoke,
        SMOKE,
        np.full_like(SMOKE, 0.6),
        apply_smoke,
        "TensorXf",
        (0.02, 0.05, 0.1),
        (0.01, 10.0),
        "least_squares",
        spp=16,
        spp_derivatives=64,
        size=32,
        iterations=24,
    )
