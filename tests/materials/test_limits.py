"""No material reflects less than nothing, or what isn't a number, at the ends of its parameters' ranges."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext
from djpt.jit.types import Float, Point2f
from tests.kit.materials import interaction

COUNT = 4096
INDICES = (1e-2, 0.5, 1.0, 1.0 + 1e-6, 1.5, 1e3)
METALS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1e-6), (1.0 + 1e-6, 0.0), (1e6, 0.0), (0.0, 1e6), (1e6, 1e6), (1e-6, 1e-6))
ROUGH = ((0.0, "ggx"), (1.0, "ggx"), (0.0, "beckmann"), (1.0, "beckmann"))


def described() -> dict[str, dict[str, Any]]:
    """Descriptions by a name."""
    found: dict[str, dict[str, Any]] = {}

    def add(plugin: str, **values: Any) -> None:
        found[f"{plugin} {' '.join(f'{key}={value}' for key, value in values.items())}"] = {"type": plugin, **values}

    for eta, k in METALS:
        add("conductor", eta=eta, k=k)
        for alpha, distribution in ROUGH:
            add("roughconductor", eta=eta, k=k, alpha=alpha, distribution=distribution)
    for index in INDICES:
        for plugin, nonlinear in itertools.product(("plastic", "pplastic"), (False, True)):
            extra = {"nonlinear": nonlinear} if plugin == "plastic" else {}
            add(plugin, int_ior=index, ext_ior=1.0, diffuse_reflectance=1.0, **extra)
        for plugin in ("dielectric", "thindielectric", "glass"):
            add(plugin, int_ior=index, ext_ior=1.0)
        for alpha, distribution in ROUGH:
            add("roughdielectric", int_ior=index, ext_ior=1.0, alpha=alpha, distribution=distribution)
            add("roughplastic", int_ior=index, ext_ior=1.0, alpha=alpha, distribution=distribution, nonlinear=True)
            add("roughplastic", int_ior=index, ext_ior=1.0, alpha=alpha, distribution=distribution)
    for low in itertools.product((0.0, 1.0), repeat=4):
        values = dict(zip(("roughness", "metallic", "spec_trans", "clearcoat"), low, strict=True))
        add("principled", **values, sheen=1.0, sheen_tint=1.0, anisotropic=1.0, flatness=1.0, clearcoat_gloss=1.0)
        add("principledthin", roughness=low[0], anisotropic=low[1], spec_trans=low[2], diff_trans=2 * low[3])
    for name, value in (("absorption", 0.0), ("longitudinal_roughness", 0.01), ("azimuthal_roughness", 1.0)):
        add("hair", **{name: value})
    for exponent in (0.0, 1e4):
        add("phong", exponent=exponent)
        add("blinn", exponent=exponent)
    return found


CASES = described()
DIRECTIONS = np.random.default_rng(5).normal(size=(2, 3, COUNT))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)


@pytest.mark.sparse(15)
@pytest.mark.parametrize("plugin", sorted({node["type"] for node in CASES.values()}))
def test_nothing_is_negative(plugin: str) -> None:
    rng = np.random.default_rng(7)
    u, v = Float(rng.random(COUNT)), Point2f(rng.random((2, COUNT)))
    wrong, tried = [], 0
    for name, node in CASES.items():
        if node["type"] != plugin:
            continue
        try:
            bsdf = djpt.load_dict(node)
        except djpt.DjptError:
            continue  # out of range: refused
        si = interaction(djpt.Vector3f(DIRECTIONS[0]))
        value, pdf = bsdf.eval_pdf(BSDFContext(), si, djpt.Vector3f(DIRECTIONS[1]))
        tried += 1
        bs, weight = bsdf.sample(BSDFContext(), si, u, v)
        for what, numbers in (("value", value), ("pdf", pdf), ("weight", weight), ("sampled pdf", bs.pdf)):
            least = np.array(numbers).min()
            if not least >= 0:
                wrong.append(f"{name}: {what} {least}")
    assert tried and not wrong, wrong
