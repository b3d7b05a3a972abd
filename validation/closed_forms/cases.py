"""Scenes whose radiance a formula gives: rooms, floors, glass and metal, matter."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from djpt.core.transforms import ScalarTransform4f as T
from djpt.scenes import furnace

__all__ = [
    "ABOVE",
    "ALBEDO",
    "BELOW",
    "CASES",
    "ClosedForm",
    "area",
    "camera",
    "dielectric",
    "floor",
    "pane",
    "parallel_rectangle",
]

ALBEDO = 0.6
"""The reflectance of floors."""

Keys = dict[str, Any]


@dataclass(frozen=True)
class ClosedForm:
    """A scene all of whose pixels have the same radiance, which a formula gives.

    * `name`: for tables and command lines.
    * `formula`: in words of the field, ASCII.
    * `source`: where the formula comes from.
    * `scene`: makes the scene's dict, without an integrator.
    * `radiance`: what the formula gives, the same in all channels.
    * `depth`: the number of edges of the longest path, for integrators to be told.
    * `integrators`: the names of the integrators that find all of this light.
    * `exact`: the relative error that an approximation of the scene causes, such as a floor that isn't endless.
    * `terms`: the radiance of paths of 1, 2, .. edges, which add up to `radiance`, where formulas give it.
    """

    name: str
    formula: str
    source: str
    scene: Callable[[], Keys]
    radiance: float
    depth: int
    integrators: tuple[str, ...]
    exact: float = 1e-4
    terms: tuple[float, ...] = ()


def camera(target: Any, origin: Any, up: Any = (0, 1, 0), size: int = 8, fov: float = 1e-3) -> Keys:
    """A camera of narrow view: all its pixels see one point."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return {"type": "perspective", "fov": fov, "to_world": T().look_at(origin, target, up), "film": film}


def area(radiance: float) -> Keys:
    """The emitter of a lamp."""
    return {"type": "area", "radiance": radiance}


def floor(**lights: Keys) -> Keys:
    """The origin of a large diffuse floor z = 0, seen from the side, under some lights."""
    plane = {"type": "rectangle", "to_world": T().scale(1000.0), "bsdf": {"type": "diffuse", "reflectance": ALBEDO}}
    return {"type": "scene", "sensor": camera((0, 0, 0), (3, 3, 2.0), up=(0, 0, 1)), "floor": plane, **lights}


# ---- rooms whose walls all shine, or reflect each other: geometric series --------------------


FINDING_ALL = ("path", "prb", "path_naive", "prb_basic", "path_nee", "distributed", "volpath", "volpathmis", "bdpt")
DEPTH = 5
GREY = 0.7


def shining_sphere() -> dict[str, Any]:
    """The inside of a diffuse sphere that shines with radiance 1."""
    shell = {
        "type": "sphere",
        "radius": 2.0,
        "flip_normals": True,
        "bsdf": {"type": "diffuse", "reflectance": GREY},
        "emitter": area(1.0),
    }
    return {"type": "scene", "sensor": camera((0, 0, 0), (0.3, 0.2, 1), fov=60.0), "shell": shell}


def shining_box() -> dict[str, Any]:
    """The built-in furnace, small."""
    scene = furnace(GREY, 1.0)
    scene["sensor"]["film"].update(width=8, height=8)
    del scene["integrator"]
    return scene


def facing_plates() -> dict[str, Any]:
    """Two endless parallel plates, of which the upper one shines with radiance 1; the camera sees the lower one."""
    half = {"type": "diffuse", "reflectance": 0.5}
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (0.3, 0.3, 0.5), up=(0, 0, 1)),
        "lower": {"type": "rectangle", "to_world": T().scale(20000.0), "bsdf": half},
        "upper": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(20000.0),
            "bsdf": half,
            "emitter": area(1.0),
        },
    }


def lamp_in_a_sphere() -> dict[str, Any]:
    """A point light in the centre of a diffuse sphere."""
    scene = shining_sphere()
    del scene["shell"]["emitter"]
    return {**scene, "lamp": {"type": "point", "position": [0, 0, 0], "intensity": 3.0}}


SERIES = tuple(GREY**k for k in range(DEPTH))
# The lamp's irradiance I / R^2 is constant, so the radiance after one reflection is rho / pi of it. A uniform radiance
# L on the wall of a sphere has the irradiance pi L everywhere, so each further reflection is rho times the one before.
INTEGRATED = (0.0, *(3.0 / (math.pi * 2.0**2) * GREY**k for k in range(1, DEPTH)))
PLATES = (0.0, 0.5, 0.0, 0.5**3, 0.0, 0.5**5)

ROOMS = (
    ClosedForm(
        "shining sphere",
        "L = e (1 + rho + .. + rho^(n - 1))",
        "geometric series; the furnace of P. Shirley and others",
        shining_sphere,
        sum(SERIES),
        DEPTH,
        (*FINDING_ALL, "ptracer"),
        # A ray that leaves the wall at a low angle comes back so soon that the distance by which it is moved off the
        # wall counts. Half of a radiance of 1 + rho comes from MIS weights, which look at the distance.
        3e-4,
        SERIES,
    ),
    ClosedForm(
        "shining box",
        "L = e (1 + rho + .. + rho^(n - 1))",
        "geometric series",
        shining_box,
        sum(SERIES),
        DEPTH,
        # In the corners of the box the variance of `path_nee` is infinite.
        (*(name for name in FINDING_ALL if name != "path_nee"), "ptracer"),
        3e-4,
        SERIES,
    ),
    ClosedForm(
        "integrating sphere",
        "L = I / (pi R^2) (rho + rho^2 + .. + rho^(n - 1))",
        "R. Ulbricht (1900)",
        lamp_in_a_sphere,
        sum(INTEGRATED),
        DEPTH,
        ("path", "prb", "path_nee", "distributed", "volpath", "volpathmis", "bdpt", "ptracer"),
        terms=INTEGRATED,
    ),
    ClosedForm(
        "facing plates",
        "L = e (rho + rho^3 + ..)",
        "radiosity of two endless parallel planes",
        facing_plates,
        sum(PLATES),
        7,
        ("path", "prb", "path_naive", "prb_basic"),
        1e-3,
        PLATES,
    ),
)
"""Closed forms of light that is reflected many times."""


# ---- light on a diffuse floor: inverse squares and form factors ------------------------------


SAMPLING_LIGHTS = ("path", "prb", "direct", "path_nee", "distributed", "volpath", "volpathmis", "bdpt")
BY_CHANCE = ("path_naive", "prb_basic")
"""Integrators that find lamps by directions of BSDFs alone, and so no points and no parallel light."""

HOWELL = "J. Howell, A Catalog of Radiation Heat Transfer Configuration Factors"
RADIANCE = 4.0


def parallel_rectangle(a: float, b: float, c: float) -> float:
    """Form factor of a small patch to a rectangle a x b in a parallel plane at distance c, one corner above it."""
    x, y = a / c, b / c
    p, q = math.sqrt(1 + x * x), math.sqrt(1 + y * y)
    return (x / p * math.atan(y / p) + y / q * math.atan(x / q)) / (2 * math.pi)


def perpendicular_rectangle(a: float, b: float, c: float) -> float:
    """Form factor of a small patch to a rectangle at distance c, upright, of height a from the patch's plane, width b.

    The patch lies in front of one of its lower corners.
    """
    x, y = a / b, c / b
    return (math.atan(1 / y) - y / math.hypot(x, y) * math.atan(1 / math.hypot(x, y))) / (2 * math.pi)


def disk_overhead(radius: float, height: float) -> float:
    """Form factor of a small patch to a disk whose axis goes through it."""
    return radius**2 / (radius**2 + height**2)


def half_a_sky() -> dict[str, Any]:
    """A black endless wall hides half of the sky from the foot of it."""
    black = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": 0.0}}
    turned = T().translate([-1e-3, 0, 0]).rotate([0, 1, 0], 90).scale(1000.0)
    wall = {"type": "rectangle", "to_world": turned, "bsdf": black}
    return floor(sky={"type": "constant", "radiance": RADIANCE}, wall=wall)


def painted() -> dict[str, Any]:
    """A rectangle with a dark half below a bright one, under a sky; the camera sees the bright half, where v > 1/2."""
    paint = {
        "type": "bitmap",
        "data": np.array([[0.2], [0.8]], np.float32)[..., None].repeat(3, axis=2),
        "raw": True,
        "filter_type": "nearest",
    }
    return {
        "type": "scene",
        "sensor": camera((0, 0.5, 0), (0, 0.5, 3.0)),
        "sky": {"type": "constant", "radiance": RADIANCE},
        "picture": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": paint}},
    }


FLOORS = (
    ClosedForm(
        "point light",
        "L = rho / pi I cos / r^2",
        "inverse square law; J. H. Lambert, Photometria (1760)",
        lambda: floor(light={"type": "point", "position": [1.0, 0, 1.0], "intensity": 3.0}),
        ALBEDO / math.pi * 3.0 / math.sqrt(2) / 2,
        2,
        (*SAMPLING_LIGHTS, "whitted"),
    ),
    ClosedForm(
        "sunlight",
        "L = rho / pi E cos",
        "J. H. Lambert, Photometria (1760)",
        lambda: floor(sun={"type": "directional", "direction": [math.sqrt(0.75), 0, -0.5], "irradiance": 2.0}),
        ALBEDO / math.pi * 2.0 * 0.5,
        2,
        (*SAMPLING_LIGHTS, "whitted"),
    ),
    ClosedForm(
        "two lights",
        "L = rho / pi (I_1 cos_1 / r_1^2 + I_2 cos_2 / r_2^2)",
        "light adds up",
        lambda: floor(
            near={"type": "point", "position": [0, 0, 1.0], "intensity": 1.0},
            far={"type": "point", "position": [0, 0, 2.0], "intensity": 12.0},
        ),
        ALBEDO / math.pi * (1.0 + 12.0 / 4),
        2,
        tuple(name for name in SAMPLING_LIGHTS if name != "distributed"),
    ),
    ClosedForm(
        "half a sky",
        "L = rho e / 2",
        "form factor 1/2 of a half space seen edge-on",
        half_a_sky,
        ALBEDO * RADIANCE / 2,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        1e-3,
    ),
    ClosedForm(
        "painted floor",
        "L = rho(u, v) e",
        "texture coordinates: the rows of a bitmap begin at v = 0",
        painted,
        0.8 * RADIANCE,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        3e-4,
    ),
    ClosedForm(
        "white sky",
        "L = rho e",
        "form factor 1 of all that is above",
        lambda: floor(sky={"type": "constant", "radiance": RADIANCE}),
        ALBEDO * RADIANCE,
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
        3e-4,
    ),
    ClosedForm(
        "spherical lamp",
        "L = rho e (r / d)^2 cos",
        f"{HOWELL}, B-5",
        lambda: floor(lamp={"type": "sphere", "center": [1.5, 0, 1.0], "radius": 0.6, "emitter": area(RADIANCE)}),
        ALBEDO * RADIANCE * 0.6**2 / 3.25 / math.sqrt(3.25),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "disk overhead",
        "L = rho e r^2 / (r^2 + h^2)",
        f"{HOWELL}, B-12",
        lambda: floor(
            lamp={
                "type": "disk",
                "to_world": T().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(0.7),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * disk_overhead(0.7, 1.0),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "rectangle overhead",
        "L = rho e F, corner over the point",
        f"{HOWELL}, B-3",
        lambda: floor(
            lamp={
                "type": "rectangle",
                "to_world": T().translate([0.75, 0.4, 0.7]).rotate([1, 0, 0], 180).scale([0.75, 0.4, 1]),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * parallel_rectangle(1.5, 0.8, 0.7),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
    ClosedForm(
        "upright rectangle",
        "L = rho e F, standing on the floor",
        f"{HOWELL}, B-4",
        lambda: floor(
            lamp={
                "type": "rectangle",
                "to_world": T().translate([-0.8, 0.6, 0.5]).rotate([0, 1, 0], 90).scale([0.5, 0.6, 1]),
                "emitter": area(RADIANCE),
            }
        ),
        ALBEDO * RADIANCE * perpendicular_rectangle(1.0, 1.2, 0.8),
        2,
        (*SAMPLING_LIGHTS, *BY_CHANCE),
    ),
)
"""Closed forms of direct light."""


# ---- panes, slabs, mirrors and metals: Fresnel's equations -----------------------------------


FOLLOWING = ("path", "prb", "path_naive", "prb_basic", "whitted", "distributed", "volpath", "volpathmis", "bdpt")
ABOVE, BELOW, ANGLE = 2.0, 5.0, 50.0


def dielectric(angle: float, ior: float) -> float:
    """Reflectance of unpolarised light at an interface; `angle` in degrees, outside."""
    outside, inside = math.cos(math.radians(angle)), math.sqrt(1 - (math.sin(math.radians(angle)) / ior) ** 2)
    perpendicular = (outside - ior * inside) / (outside + ior * inside)
    parallel = (ior * outside - inside) / (ior * outside + inside)
    return (perpendicular**2 + parallel**2) / 2


def pane(angle: float, **shape: Any) -> dict[str, Any]:
    """A pane z < 0 between a sky of radiance ABOVE and a black floor that shines with BELOW.

    It is seen from above, `angle` degrees off its normal.
    """
    a = math.radians(angle)
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (3 * math.sin(a), 0, 3 * math.cos(a))),
        "sky": {"type": "constant", "radiance": ABOVE},
        "pane": shape,
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, 0, -1]).scale(20.0),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": area(BELOW),
        },
    }


def slab() -> dict[str, Any]:
    """A slab of glass."""
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return pane(ANGLE, type="cube", to_world=T().translate([0, 0, -0.1]).scale([20, 20, 0.1]), bsdf=glass)


def metal() -> dict[str, Any]:
    """A flat piece of metal under the sky, seen from above."""
    return pane(0.0, type="rectangle", to_world=T().scale(20.0), bsdf={"type": "conductor", "eta": 0.2, "k": 3.9})


def mirrored_lamp() -> dict[str, Any]:
    """A lamp that is seen in a mirror at 45 degrees."""
    bsdf = {"type": "conductor", "material": "none", "specular_reflectance": 0.6}
    to_world = T().look_at(origin=[-2, 0, 2], target=[0, 0, 0], up=[0, 1, 0]).scale(0.2)
    lamp = {"type": "rectangle", "to_world": to_world, "emitter": area(7.0)}
    return pane(45.0, type="rectangle", to_world=T().scale(20.0), bsdf=bsdf) | {"lamp": lamp}


def water() -> dict[str, Any]:
    """Water over a black floor that shines, seen from above at ANGLE."""
    glass = {"type": "dielectric", "int_ior": 1.33, "ext_ior": 1.0}
    return pane(ANGLE, type="rectangle", to_world=T().scale(20.0), bsdf=glass)


W = dielectric(ANGLE, 1.33)
R = dielectric(ANGLE, 1.5)
THIN = 2 * R / (1 + R)
SLAB_DEPTH = 16
UP = [ABOVE * (1 - R) ** 2 * R ** (n - 3) for n in range(4, SLAB_DEPTH + 1, 2)]
DOWN = [BELOW * (1 - R) ** 2 * R ** (n - 3) for n in range(3, SLAB_DEPTH + 1, 2)]
# Light that was reflected inside 0, 1, .. times. Up: R at once, then T^2 R^(2 k + 1) after 4 + 2 k edges; down:
# T^2 R^(2 k) after 3 + 2 k.
SLAB = (0.0, ABOVE * R, *(term for pair in zip(DOWN, UP, strict=True) for term in pair))
THIN_PANE = (0.0, ABOVE * THIN + BELOW * (1 - THIN))

GLASS = (
    ClosedForm(
        "thin pane",
        "L = R' e_above + (1 - R') e_below, R' = 2 R / (1 + R)",
        "A. Fresnel (1823); G. G. Stokes (1862) for the reflections inside",
        lambda: pane(
            ANGLE,
            type="rectangle",
            to_world=T().scale(20.0),
            bsdf={"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
        ),
        sum(THIN_PANE),
        2,
        (*FOLLOWING, "direct"),
        terms=THIN_PANE,
    ),
    ClosedForm(
        "slab of glass",
        "L = e_above (R + T^2 R (1 + R^2 + ..)) + e_below T^2 (1 + R^2 + ..)",
        "A. Fresnel (1823)",
        slab,
        sum(SLAB),
        SLAB_DEPTH,
        FOLLOWING,
        terms=SLAB,
    ),
    ClosedForm(
        "mirrored lamp",
        "L = rho e",
        "radiance is constant along rays",
        mirrored_lamp,
        0.6 * 7.0,
        2,
        (*FOLLOWING, "direct"),
        terms=(0.0, 0.6 * 7.0),
    ),
    ClosedForm(
        "lamp under water",
        "L = R e_above + (1 - R) e_below / eta^2",
        "basic radiance, R. Clausius (1864); F. Nicodemus (1963)",
        water,
        ABOVE * W + BELOW * (1 - W) / 1.33**2,
        2,
        FOLLOWING,
    ),
    ClosedForm(
        "metal",
        "L = e ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2)",
        "A.-L. Cauchy (1836); Born and Wolf, Principles of Optics, 14.2",
        metal,
        ABOVE * ((0.2 - 1) ** 2 + 3.9**2) / ((0.2 + 1) ** 2 + 3.9**2),
        2,
        FOLLOWING,
    ),
)
"""Closed forms of specular reflection and refraction."""


# ---- matter that absorbs and scatters: Beer's law, furnaces, single scattering ---------------


FOLLOWING_MEDIA = ("volpath", "volpathmis", "prbvolpath")
MANY = 1000
"""Edges that no path of note has."""


def body(medium: dict[str, Any], **others: Any) -> dict[str, Any]:
    """A unit ball of a medium, seen along a diameter."""
    ball = {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium}
    return {"type": "scene", "sensor": camera((0, 0, 0), (0, 0, 4), fov=0.01), "ball": ball, **others}


def henyey_greenstein(g: float, cosine: float) -> float:
    """The density of turning by an angle."""
    return (1 - g**2) / (4 * math.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)


def slab_in_sunlight() -> dict[str, Any]:
    """A slab of optical thickness 1 in perpendicular light of irradiance 1, seen from 50 degrees."""
    angle = math.radians(50.0)
    medium = {"type": "homogeneous", "sigma_t": 0.5, "albedo": 0.6, "phase": {"type": "hg", "g": 0.5}}
    return {
        "type": "scene",
        "sensor": camera((0, 0, 0), (4 * math.sin(angle), 0.0, 4 * math.cos(angle)), fov=0.01),
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0},
        "slab": {
            "type": "cube",
            "to_world": T().scale([50, 50, 1]),
            "bsdf": {"type": "null"},
            "interior": medium,
        },
    }


FOG = {"type": "homogeneous", "sigma_t": 3.0, "albedo": 1.0, "phase": {"type": "hg", "g": 0.6}}
SKY = {"type": "constant", "radiance": 1.0}
MU = math.cos(math.radians(50.0))
BACK = 0.6 * henyey_greenstein(0.5, -MU) / (1 + MU) * (1 - math.exp(-2 * 0.5 * (1 + 1 / MU)))

MATTER = (
    ClosedForm(
        "absorbing ball",
        "L = e exp(-2 sigma_t)",
        "A. Beer (1852)",
        lambda: body({"type": "homogeneous", "sigma_t": 0.6, "albedo": 0.0}, sky=SKY),
        math.exp(-1.2),
        MANY,
        FOLLOWING_MEDIA,
        3e-4,
    ),
    ClosedForm(
        "white ball of fog",
        "L = e: what absorbs nothing can't be seen",
        "furnace; S. Chandrasekhar, Radiative Transfer (1960)",
        lambda: body(FOG, sky=SKY),
        1.0,
        MANY,
        FOLLOWING_MEDIA,
        5e-4,
    ),
    ClosedForm(
        "slab in sunlight",
        "L = albedo p(cos) / (1 + mu) (1 - exp(-tau (1 + 1 / mu)))",
        "single scattering; S. Chandrasekhar, Radiative Transfer (1960)",
        slab_in_sunlight,
        BACK,
        2,
        FOLLOWING_MEDIA,
        5e-4,
    ),
)
"""Closed forms of media."""


CASES: dict[str, ClosedForm] = {case.name: case for case in (*FLOORS, *ROOMS, *GLASS, *MATTER)}
"""The closed forms by name."""
