"""Files of measured materials: a rough metal tabulated, and one of made-up numbers that differ by direction."""

from __future__ import annotations

import math
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt.description.tensor_files import write_tensors
from djpt.distributions.marginal_2d import MarginalContinuous2D2
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.materials.fresnel import reflect
from djpt.materials.microfacet import MicrofacetDistribution

__all__ = ["ALPHA", "TINT", "anisotropic", "rough_metal"]

ALPHA = 0.5
"""The roughness of the metal, whose microfacets reflect everything."""

TINT = (0.9, 0.6, 0.3)
"""The share of light that it reflects."""

FOLDER = tempfile.TemporaryDirectory(prefix="djpt-measured-")


def write(name: str, **fields: Any) -> str:
    """Write a file and return its path; it is gone when Python ends."""
    path = Path(FOLDER.name) / f"{name}.bsdf"
    tensors = {key: np.asarray(value, np.float32) for key, value in fields.items()}
    write_tensors(path, {**tensors, "jacobian": np.array([1], np.uint8), "description": "made for tests"})
    return str(path)


def angles(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """The elevation and azimuth at the nodes of a square."""
    theta, phi = np.linspace(0, 1, columns) ** 2 * (math.pi / 2), (2 * np.linspace(0, 1, rows) - 1) * math.pi
    found_phi, found_theta = np.meshgrid(phi, theta, indexing="ij")
    return found_theta, found_phi


def directions(theta: np.ndarray, phi: np.ndarray) -> Vector3f:
    """Unit vectors."""
    sin, cos = np.sin(theta).ravel(), np.cos(theta).ravel()
    parts = sin * np.cos(phi).ravel(), sin * np.sin(phi).ravel(), cos
    return Vector3f(*(Float(part.astype(np.float32)) for part in parts))


@cache
def rough_metal(size: int = 33) -> str:
    """A GGX metal of the roughness `ALPHA` that reflects `TINT`, the same from all sides."""
    surface = MicrofacetDistribution("ggx", *[djpt.Float(ALPHA)] * 2)
    theta_i = np.linspace(0, 0.49 * math.pi, 9)
    theta, phi = angles(size, size)
    m = directions(theta, phi)
    shape = theta.shape
    ndf = np.array(surface.eval(m)).reshape(shape)
    low = np.minimum(theta, math.acos(1e-3))
    sigma = (1 / np.array(surface.smith_g1_over_cos(directions(low, phi)))).reshape(shape)
    area = 2 * math.pi**2 * np.linspace(0, 1, size)[None] * np.sin(theta)
    vndf, warped = [], []
    for angle in theta_i:
        wi = Vector3f(math.sin(angle), 0, math.cos(angle))
        vndf.append(np.array(surface.pdf(wi, m)).reshape(shape) * area + 1e-6)
    axes = [[0.0], theta_i.tolist()]
    warp = MarginalContinuous2D2(np.array(vndf)[None], axes)
    x, y = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    square = Point2f(*(Float(part.ravel().astype(np.float32)) for part in (x, y)))
    for angle in theta_i:
        wi = Vector3f(math.sin(angle), 0, math.cos(angle))
        u_m = np.array(warp.sample(square, [Float(0), Float(angle)])[0])
        facet = directions(u_m[0] ** 2 * (math.pi / 2), (2 * u_m[1] - 1) * math.pi)
        wo = reflect(wi, facet)
        seen = np.array(surface.smith_g1_over_cos(wo)) * np.array(wo.z)
        warped.append(np.where(np.array(wo.z) > 0, seen, 0).reshape(shape))
    share = np.array(warped)
    rgb = share[None, :, None] * np.array(TINT)[None, None, :, None, None]
    return write(
        f"metal{size}", theta_i=theta_i, phi_i=[0.0], ndf=ndf, sigma=sigma, vndf=np.array(vndf)[None],
        luminance=share[None] + 1e-3, rgb=rgb,
    )  # fmt: skip


@cache
def anisotropic(turns: int = 1) -> str:
    """Made-up numbers that differ from all sides; with `turns` of 2 or 4, given for a half or a quarter of a turn."""
    rng = np.random.default_rng(turns)
    size = 25
    theta_i, phi_i = np.linspace(0, 1.5, 4), np.linspace(-math.pi, -math.pi + 2 * math.pi / turns, 5)
    theta, phi = angles(size, size)
    area = np.linspace(0, 1, size)[None] * np.sin(theta)
    bumps = np.cos(2 * phi[None, None] + phi_i[:, None, None, None] + theta_i[:, None, None])
    shape = (len(phi_i), len(theta_i))
    return write(
        f"made_up{turns}", theta_i=theta_i, phi_i=phi_i, ndf=np.cos(theta) / math.pi, sigma=0.5 + 0.5 * np.cos(theta),
        vndf=area * np.exp(-2 * theta) * (1 + 0.5 * bumps), luminance=rng.uniform(0.4, 1, (*shape, 6, 6)),
        rgb=rng.uniform(0.1, 0.9, (*shape, 3, 6, 6)),
    )  # fmt: skip
