"""Parameter sets of every BSDF, for the tests that all of them must pass, and the surface points to ask them at."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import SurfaceInteraction3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Attached, Group
from djpt.jit.types import Float, Normal3f, Point2f, Point3f, TensorXf, UInt32, Vector3f
from tests.kit.measured import anisotropic, rough_metal
from tests.kit.parameter_sets import slow_but_first

__all__ = [
    "NAMES",
    "PLUGINS",
    "SETS",
    "SHARED",
    "UNKNOWN_TO_MITSUBA",
    "ball",
    "bitmap",
    "bsdf",
    "cases",
    "checks",
    "first_of_each",
    "in_kernel",
    "interaction",
    "opaque_wi",
    "plugin_of",
    "rgb",
]

Description = dict[str, Any]


def rgb(*value: float) -> Description:
    return {"type": "rgb", "value": list(value)}


def texels(*shape: int, low: float = 0.1, high: float = 0.9, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, shape).astype(np.float32)


def bitmap(data: np.ndarray, **keys: Any) -> Description:
    """A texture from numbers."""
    return {"type": "bitmap", "data": TensorXf(data), "raw": True, **keys}


def normals(rows: int, columns: int, tilt: float = 0.3) -> np.ndarray:
    """A normal map that tilts at random."""
    n = np.random.default_rng(1).uniform(-tilt, tilt, (rows, columns, 3))
    n[..., 2] = 1
    return ((n / np.linalg.norm(n, axis=2, keepdims=True) + 1) / 2).astype(np.float32)


def checks(color0: Any, color1: Any, u: float = 4.0, v: float = 3.0) -> Description:
    """A pattern on (u, v)."""
    return {"type": "checkerboard", "color0": color0, "color1": color1, "to_uv": T().scale([u, v, 1])}


CLAY, TEAL = rgb(0.9, 0.5, 0.1), rgb(0.1, 0.4, 0.6)
DIFFUSE, BLUE = {"type": "diffuse", "reflectance": CLAY}, {"type": "diffuse", "reflectance": TEAL}
GOLD = {"type": "roughconductor", "material": "Au", "alpha": 0.3}

EVERYTHING = {
    "base_color": CLAY, "spec_trans": 0.6, "metallic": 0.3, "clearcoat": 0.5, "clearcoat_gloss": 0.2, "sheen": 0.4,
    "sheen_tint": 0.3, "anisotropic": 0.5, "spec_tint": 0.4, "flatness": 0.3, "specular": 0.7, "roughness": 0.45,
}  # fmt: skip
EVERYTHING_THIN = {
    "base_color": CLAY, "spec_trans": 0.6, "diff_trans": 0.8, "anisotropic": 0.3, "spec_tint": 0.7, "sheen": 0.4,
    "sheen_tint": 0.3, "flatness": 0.5, "eta": 1.3, "roughness": 0.5,
}  # fmt: skip

SETS: dict[str, Callable[[], dict[str, Description]]] = {
    "diffuse": lambda: {
        "colour": {"reflectance": CLAY},
        "white": {"reflectance": 1.0},
        "bitmap": {"reflectance": bitmap(texels(6, 8, 3))},
    },
    "twosided": lambda: {
        "one": {"inner": DIFFUSE},
        "two": {"front": DIFFUSE, "back": {"type": "roughconductor", "alpha": 0.4, "distribution": "ggx"}},
        "plastic": {"inner": {"type": "plastic", "diffuse_reflectance": TEAL}},
        "textured": {"inner": {"type": "diffuse", "reflectance": checks(0.3, CLAY)}},
    },
    "conductor": lambda: {
        "gold": {"material": "Au"},
        "plain": {},
        "index": {"eta": rgb(0.2, 0.9, 1.1), "k": rgb(3.9, 2.4, 2.1), "specular_reflectance": checks(CLAY, 0.9)},
    },
    "dielectric": lambda: {
        "glass": {},
        "tinted": {"int_ior": 1.8, "ext_ior": "water", "specular_reflectance": CLAY, "specular_transmittance": TEAL},
        "bubble": {"int_ior": "air", "ext_ior": "diamond"},
    },
    "thindielectric": lambda: {
        "bubble": {},
        "tinted": {"int_ior": "pet", "specular_reflectance": CLAY, "specular_transmittance": checks(TEAL, 0.9)},
    },
    "glass": lambda: {
        "glass": {"int_ior": 1.5, "ext_ior": 1.0},
        "reflection": {"transmission": False},
        "refraction": {"reflection": False},
        "schlick": {"fresnel": "schlick", "int_ior": 1.8},
    },
    "mirror": lambda: {"tinted": {"reflectance": CLAY}, "plain": {}, "schlick": {"fresnel": "schlick"}},
    "null": lambda: {"": {}},
    "roughconductor": lambda: {
        "gold": {"material": "Au", "alpha": 0.3},
        "polished": {"material": "Cu", "alpha": 0.05},
        "ggx": {"material": "Al", "alpha": 0.2, "distribution": "ggx"},
        "brushed": {"alpha_u": 0.05, "alpha_v": 0.4, "eta": rgb(0.2, 0.9, 1.1), "k": 2.0},
        "brushed ggx": {"alpha_u": 0.5, "alpha_v": 0.1, "material": "Ag", "distribution": "ggx"},
        "all facets": {"alpha": 0.3, "sample_visible": False},
        "all ggx facets": {"alpha": 0.3, "sample_visible": False, "distribution": "ggx"},
        "textured": {"alpha": bitmap(texels(5, 7, 1)), "specular_reflectance": checks(CLAY, 0.9), "material": "Cu"},
        "roughest": {"alpha": 1.0, "distribution": "ggx"},
    },
    "roughdielectric": lambda: {
        "glass": {"alpha": 0.3},
        "polished": {"alpha": 0.05},
        "ggx": {"alpha": 0.4, "distribution": "ggx", "specular_transmittance": TEAL, "specular_reflectance": CLAY},
        "brushed": {"alpha_u": 0.1, "alpha_v": 0.5, "int_ior": 1.9},
        "all facets": {"alpha": 0.3, "sample_visible": False},
        "bubble": {"alpha": 0.3, "int_ior": "air", "ext_ior": "water", "distribution": "ggx"},
        "textured": {"alpha": bitmap(texels(5, 7, 1, low=0.2))},
    },
    "plastic": lambda: {
        "colour": {"diffuse_reflectance": CLAY},
        "nonlinear": {"nonlinear": True, "int_ior": 1.9, "diffuse_reflectance": TEAL, "specular_reflectance": 0.8},
        "textured": {"diffuse_reflectance": bitmap(texels(6, 8, 3))},
    },
    "roughplastic": lambda: {
        "colour": {"diffuse_reflectance": CLAY, "alpha": 0.2},
        "polished": {"diffuse_reflectance": TEAL, "alpha": 0.05},
        "ggx": {"distribution": "ggx", "alpha": 0.5, "nonlinear": True, "int_ior": 1.9, "diffuse_reflectance": CLAY},
        "all facets": {"alpha": 0.3, "sample_visible": False},
        "textured": {"diffuse_reflectance": checks(CLAY, 0.9), "specular_reflectance": 0.7, "alpha": 0.3},
    },
    "pplastic": lambda: {
        "colour": {"diffuse_reflectance": CLAY, "alpha": 0.2},
        "polished": {"diffuse_reflectance": TEAL, "alpha": 0.05, "int_ior": 1.9, "specular_reflectance": 0.7},
        "brushed": {"alpha_u": 0.1, "alpha_v": 0.5, "distribution": "ggx", "eta": 1.7},
        "all facets": {"alpha": 0.3, "sample_visible": False},
        "textured": {"diffuse_reflectance": bitmap(texels(6, 8, 3)), "alpha": bitmap(texels(5, 7, 1, low=0.2))},
    },
    "measured": lambda: {
        "metal": {"filename": rough_metal(17)},
        "made up": {"filename": anisotropic(1)},
        "half a turn": {"filename": anisotropic(2)},
        "a quarter": {"filename": anisotropic(4)},
    },
    "polarizer": lambda: {"ideal": {}, "tinted": {"transmittance": checks(CLAY, 0.9), "theta": 30.0}},
    "retarder": lambda: {"ideal": {}, "tinted": {"transmittance": CLAY, "theta": 30.0, "delta": 45.0}},
    "circular": lambda: {"ideal": {}, "tinted": {"transmittance": CLAY, "left_handed": True}},
    "hair": lambda: {
        "brown": {},
        "smooth": {"longitudinal_roughness": 0.15, "azimuthal_roughness": 0.2, "scale_tilt": 3.0},
        "rough": {"longitudinal_roughness": 0.9, "azimuthal_roughness": 0.9, "eumelanin": 0.1, "pheomelanin": 1.0},
        "clear": {"sigma_a": 0.0, "int_ior": 1.8, "scale_tilt": -3.0},
        "dyed": {"sigma_a": checks(CLAY, TEAL), "scale": 2.0, "azimuthal_roughness": 0.6},
    },
    "principled": lambda: {
        "everything": EVERYTHING,
        "defaults": {},
        "metal": {"metallic": 1.0, "roughness": 0.3, "base_color": CLAY},
        "brushed": {"anisotropic": 0.8, "metallic": 0.6, "roughness": 0.5},
        "coated": {"clearcoat": 1.0, "clearcoat_gloss": 0.5, "base_color": CLAY},
        "sheen": {"sheen": 1.0, "sheen_tint": 0.6, "base_color": TEAL, "roughness": 0.9},
        "flat": {"flatness": 0.7, "roughness": 0.8},
        "glass": {"spec_trans": 1.0, "eta": 1.5, "roughness": 0.4},
        "subsurface": {
            "subsurface": bitmap(texels(4, 4, 1, low=0.2)),
            "base_color": CLAY,
            "subsurface_color": 0.6,
            "metallic": 0.2,
            "roughness": 0.4,
            "eta": 1.4,
        },
        "bubble": {"spec_trans": 0.8, "eta": 0.7, "roughness": 0.6, "metallic": 0.1, "spec_tint": 0.5},
        "textured": {
            "base_color": bitmap(texels(6, 8, 3)),
            "roughness": bitmap(texels(5, 7, 1, low=0.3)),
            "metallic": bitmap(texels(4, 4, 1)),
        },
    },
    "principledthin": lambda: {
        "everything": EVERYTHING_THIN,
        "defaults": {},
        "pane": {"spec_trans": 1.0, "roughness": 0.5, "base_color": CLAY},
        "leaf": {"diff_trans": 1.2, "base_color": TEAL, "roughness": 0.7},
        "textured": {"base_color": bitmap(texels(6, 8, 3)), "diff_trans": 0.7, "sheen": 0.6, "sheen_tint": 0.5},
    },
    "mask": lambda: {
        "diffuse": {"nested": DIFFUSE, "opacity": 0.7},
        "metal": {"nested": {"type": "twosided", "inner": GOLD}, "opacity": bitmap(texels(5, 7, 1))},
        "glass": {"nested": {"type": "dielectric"}, "opacity": 0.6},
    },
    "blendbsdf": lambda: {
        "diffuse": {"first": DIFFUSE, "second": GOLD, "weight": 0.3},
        "textured": {
            "first": DIFFUSE,
            "second": {"type": "roughplastic", "alpha": 0.2},
            "weight": bitmap(texels(5, 7, 1)),
        },
        "deltas": {"first": {"type": "conductor", "material": "Cu"}, "second": {"type": "dielectric"}, "weight": 0.4},
        "mirror": {"first": DIFFUSE, "second": {"type": "conductor"}, "weight": 0.4},
        "nested": {
            "first": {"type": "twosided", "inner": {"type": "blendbsdf", "weight": 0.8, "a": DIFFUSE, "b": BLUE}},
            "second": {"type": "roughdielectric", "alpha": 0.4},
            "weight": 0.5,
        },
    },
    "bumpmap": lambda: {
        "diffuse": {"inner": DIFFUSE, "heights": bitmap(texels(5, 7, 1)), "scale": 0.1},
        "gold": {"inner": GOLD, "heights": bitmap(texels(4, 4, 3)), "scale": 0.05},
    },
    "normalmap": lambda: {
        "diffuse": {"inner": DIFFUSE, "normalmap": bitmap(normals(6, 7))},
        "gold": {"inner": GOLD, "normalmap": bitmap(normals(5, 4))},
        "level": {"inner": DIFFUSE, "normalmap": rgb(0.5, 0.5, 1.0)},
    },
    "phong": lambda: {
        "defaults": {},
        "glossy": {"exponent": 60.0, "diffuse_reflectance": 0.1, "specular_reflectance": CLAY},
        "wide": {"exponent": 0.5, "specular_reflectance": 0.5},
    },
    "blinn": lambda: {
        "defaults": {},
        "glossy": {"exponent": 60.0, "diffuse_reflectance": 0.1, "specular_reflectance": CLAY},
        "wide": {"exponent": 0.5, "specular_reflectance": 0.5},
    },
}  # fmt: skip
"""Parameter sets by plugin and name. Made anew for each use: Mitsuba empties the tensors that it is given."""

PLUGINS = [name for name, factory in registry.registered("bsdf").items() if registry.is_own(factory)]


def sets_of(plugin: str) -> dict[str, Description]:
    """The parameter sets of one plugin, by names such as 'roughconductor-brushed'."""
    sets = SETS.get(plugin, lambda: {"": {}})()
    return {f"{plugin}-{name}".rstrip("-"): {"type": plugin, **values} for name, values in sets.items()}


NAMES = [name for plugin in PLUGINS for name in sets_of(plugin)]
"""The names of all parameter sets."""

UNKNOWN_TO_MITSUBA = frozenset({"glass", "mirror", "phong", "blinn"})


def plugin_of(name: str) -> str:
    return name.split("-")[0]


def bsdf(name: str) -> Description:
    """A new description of the parameter set."""
    return sets_of(plugin_of(name))[name]


def cases(names: Iterable[str] = NAMES) -> list[Any]:
    """Parameter sets as test parameters."""
    return [pytest.param(name, id=name) for name in names]


def first_of_each(names: Iterable[str] = NAMES, long: Iterable[str] = ()) -> list[Any]:
    """Parameter sets as test parameters: slow but for the first of each plugin, and for all of the plugins `long`."""
    return slow_but_first(names, plugin_of, long)


# ---------------------------------------------------------------- asked without a scene


def attached_values(plugin: Plugin) -> dict[tuple[int, str], Any]:
    """The values in a tree of plugins that have gradients."""
    found = {
        (id(plugin), name): getattr(plugin, name)
        for name in (*plugin.values, *plugin.tables)
        if dr.grad_enabled(getattr(plugin, name))
    }
    for name in plugin.children:
        child = getattr(plugin, name)
        if isinstance(child, Plugin):
            found |= attached_values(child)
    return found


def in_kernel(description: Description | Plugin) -> Any:
    """The BSDF as kernels see it, attached to its values' gradients."""
    plugin = description if isinstance(description, Plugin) else djpt.load_dict(description)
    return Group([plugin], [0]).at(UInt32(0), Attached(attached_values(plugin)))


def opaque_wi(wi: Any) -> Vector3f:
    """A unit vector that kernels don't know, so that one kernel serves all directions."""
    v = np.asarray(wi, np.float64)
    return Vector3f(*(dr.opaque(Float, float(x)) for x in v / np.linalg.norm(v)))


def interaction(wi: Vector3f, uv: tuple[float, float] = (0.31, 0.62), width: int = 1) -> SurfaceInteraction3f:
    """A surface point in its own frame."""
    z = Normal3f(0, 0, 1)
    frame = Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z)
    shared = {"dp_du": frame.s, "dp_dv": frame.t}
    t = dr.full(Float, 1, width)
    return SurfaceInteraction3f(t=t, p=Point3f(0), n=z, sh_frame=frame, uv=Point2f(*uv), wi=wi, **shared)


# ---------------------------------------------------------------- images


MISTAKEN = {
    # A smooth and a delta lobe: energy is lost, see `BlendBSDF`.
    "blendbsdf-mirror",
    # Facets are drawn from a rougher surface, and the weights don't know: see `RoughDielectric`.
    "roughdielectric-all facets",
}
"""Materials that Mitsuba 3.9.1 renders wrongly."""


SHARED = [
    name
    for name in NAMES
    if plugin_of(name) not in UNKNOWN_TO_MITSUBA and name not in {*MISTAKEN, "principled-subsurface"}
]
"""Materials that both renderers render alike."""


def ball(material: dict[str, Any], size: int = 64, integrator: str = "path") -> dict[str, Any]:
    """A ball over a floor under a lamp and a faint sky, seen from above and from its side."""
    # Integrators that don't follow media take no notice of it.
    interior = {"interior": {"type": "homogeneous"}} if "subsurface" in material else {}
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": 8},
        "sensor": {
            "type": "perspective",
            "fov": 32,
            "to_world": T().look_at(origin=[1, 1.5, 4.5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.4, 0.5, 0.6]}},
        "lamp": {
            "type": "rectangle",
            "to_world": T().look_at(origin=[-2, 3, 2.5], target=[0, 0, 0], up=[0, 1, 0]),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        "floor": {
            "type": "rectangle",
            "to_world": T().translate([0, -1.05, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.3, 0.2]}},
        },
        "ball": {"type": "sphere", "bsdf": material, **interior},
    }
