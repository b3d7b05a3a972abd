"""Rough metal, rough glass and plastic, in both renderers, asked without a scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import SurfaceInteraction3f
from djpt.core.warp import square_to_uniform_sphere
from djpt.description.plugin import Plugin
from djpt.dispatch.ensemble import Attached, Group
from djpt.jit.types import Float, Normal3f, Point2f, Point3f, UInt32, Vector3f
from tests.kit.arrays import in_numpy, rows

__all__ = [
    "CASES",
    "COUNT",
    "REFLECTING",
    "RGB",
    "assert_close",
    "directions",
    "full",
    "in_kernel",
    "interaction",
    "load",
    "mitsuba_interaction",
    "numbers",
]

mi = pytest.importorskip("mitsuba")


COUNT = 8192
RGB = {"type": "rgb", "value": [0.1, 0.5, 0.9]}
REFLECTING: dict[str, dict[str, Any]] = {
    "metal": {"type": "roughconductor", "material": "Au"},
    "ggx metal": {"type": "roughconductor", "distribution": "ggx", "alpha": 0.4, "specular_reflectance": RGB},
    "brushed": {"type": "roughconductor", "alpha_u": 0.05, "alpha_v": 0.4, "eta": RGB, "k": 2.0},
    "brushed ggx": {"type": "roughconductor", "alpha_u": 0.5, "alpha_v": 0.2, "distribution": "ggx", "material": "Cu"},
    "all facets": {"type": "roughconductor", "alpha": 0.3, "sample_visible": False},
    "all ggx facets": {"type": "roughconductor", "alpha": 0.3, "sample_visible": False, "distribution": "ggx"},
    "plastic": {"type": "plastic", "diffuse_reflectance": RGB},
    "coloured plastic": {"type": "plastic", "nonlinear": True, "int_ior": 1.9, "specular_reflectance": RGB},
    "black plastic": {"type": "plastic", "diffuse_reflectance": 0.0},
    "rough plastic": {"type": "roughplastic", "diffuse_reflectance": RGB},
    "ggx plastic": {"type": "roughplastic", "distribution": "ggx", "alpha": 0.5, "nonlinear": True, "int_ior": 1.9},
    "all facets of plastic": {"type": "roughplastic", "alpha": 0.3, "sample_visible": False},
    "thin plastic": {"type": "roughplastic", "alpha": 0.3, "int_ior": 1.0, "ext_ior": 1.3, "specular_reflectance": RGB},
}


CASES = REFLECTING | {
    "glass": {"type": "roughdielectric"},
    "ggx glass": {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.5, "specular_transmittance": RGB},
    "brushed glass": {"type": "roughdielectric", "alpha_u": 0.1, "alpha_v": 0.4, "specular_reflectance": RGB},
    "all facets of glass": {"type": "roughdielectric", "alpha": 0.3, "sample_visible": False},
    "bubble": {"type": "roughdielectric", "alpha": 0.3, "int_ior": "air", "ext_ior": "water", "distribution": "ggx"},
}


def numbers(columns: int, seed: int) -> Any:
    return np.random.default_rng(seed).random((columns, COUNT), dtype=np.float32)


def directions(seed: int) -> Any:
    """Unit vectors over the whole sphere, some of them grazing; (3, COUNT)."""
    v = np.array(square_to_uniform_sphere(Point2f(numbers(2, seed))))
    v[2, : COUNT // 8] *= 3e-2
    return (v / np.linalg.norm(v, axis=0)).astype(np.float32)


def owners(plugin: Plugin) -> list[tuple[Plugin, str]]:
    """All values in a tree of plugins."""
    nested = [child for name in plugin.children if isinstance(child := getattr(plugin, name), Plugin)]
    return [(plugin, name) for name in plugin.values] + [found for child in nested for found in owners(child)]


def in_kernel(bsdf: Any) -> Any:
    """The plugin as kernels see it, attached to the gradients of its values."""
    overrides = {(id(p), name): getattr(p, name) for p, name in owners(bsdf) if dr.grad_enabled(getattr(p, name))}
    return Group([bsdf], [0]).at(UInt32(0), Attached(overrides))


def load(description: dict[str, Any]) -> Any:
    return in_kernel(djpt.load_dict(description))


def interaction(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame, seen from `wi`."""
    z = Normal3f(0, 0, 1)
    frame = Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z)
    shared = {"dp_du": frame.s, "dp_dv": frame.t}
    t = dr.full(Float, 1, np.shape(wi)[1])
    p, uv = Point3f(0), Point2f(0.3, 0.6)
    return SurfaceInteraction3f(t=t, p=p, n=z, sh_frame=frame, uv=uv, wi=Vector3f(*rows(wi)), **shared)


def mitsuba_interaction(wi: Any) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi, si.uv = mi.Vector3f(*rows(wi)), mi.Point2f(0.3, 0.6)
    return si


def full(array: Any) -> Any:
    array = array if isinstance(array, np.ndarray) else in_numpy(array)
    return np.broadcast_to(array, (*array.shape[:-1], COUNT))


def assert_close(found: Any, expected: Any, lanes: Any, rtol: float, outliers: float = 2e-3) -> None:
    """Assert that nearly all lanes agree: rounding is amplified at grazing angles."""
    found, expected = full(found)[..., lanes], full(expected)[..., lanes]
    assert np.isfinite(found).all()
    assert (np.abs(found - expected) > rtol * np.abs(expected) + 1e-5).mean() <= outliers
