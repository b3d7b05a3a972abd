"""Derivatives of rough metal, rough glass and plastic by their parameters, and by what a user takes for a constant."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, BSDFFlags, has_flag
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.validation.gradcheck.losses import quotient
from tests.kit.derivatives import by_both
from tests.kit.renders import box
from tests.kit.rough_materials import (
    CASES,
    directions,
    full,
    in_kernel,
    interaction,
)

mi = pytest.importorskip("mitsuba")


DERIVATIVES = [
    ("metal", "alpha.value", 0.3),
    ("ggx metal", "alpha.value", 0.4),
    ("brushed", "alpha_u.value", 0.3),
    ("brushed ggx", "alpha_v.value", 0.3),
    ("metal", "eta.value", None),
    ("metal", "k.value", None),
    ("ggx metal", "specular_reflectance.value", None),
    ("plastic", "eta", None),
    ("coloured plastic", "diffuse_reflectance.value", None),
    ("rough plastic", "alpha", 0.3),
    ("rough plastic", "eta", None),
    ("ggx plastic", "alpha", None),
    ("ggx plastic", "eta", None),
    ("ggx plastic", "diffuse_reflectance.value", None),
    ("glass", "alpha.value", 0.3),
    ("glass", "eta", 1.7),
    ("ggx glass", "specular_transmittance.value", None),
]


def differing(values: Any, expected: Any) -> float:
    """The share of numbers that differ by more than 1 %, or 1 % of large ones."""
    large = np.quantile(np.abs(expected[expected != 0]), 0.9)
    return float((np.abs(values - expected) > 1e-2 * np.maximum(np.abs(expected), large)).mean())


@pytest.mark.sparse(8)
@pytest.mark.parametrize(("name", "key", "value"), DERIVATIVES)
def test_derivative_of_eval(name: str, key: str, value: float | None) -> None:
    bsdf = djpt.load_dict(CASES[name])
    params = djpt.traverse(bsdf)
    kind = type(params[key])
    centre = kind(params[key]) if value is None else kind(value)
    wi, wo = Vector3f(directions(12)), Vector3f(directions(13))
    si = interaction(np.array(wi))

    def evaluated(x: Any) -> Any:
        params[key] = x
        params.update()
        return in_kernel(bsdf).eval(BSDFContext(), si, wo)

    # Two terms of the derivative of a rough coat by its index nearly cancel, and differences of sums have noise.
    h = 3e-2 if key == "eta" and "rough" in CASES[name]["type"] else 5e-3
    expected = quotient(lambda x: full(evaluated(centre + x)), h)
    x = kind(centre)
    dr.enable_grad(x)
    result = evaluated(x)
    dr.set_grad(x, 1)
    found = full(dr.forward_to(result))
    assert np.isfinite(found).all()
    assert differing(found, expected) < 0.01
    # Backwards, nothing but numbers either.
    result = evaluated(x)
    dr.backward(dr.sum(result, axis=None))
    total = np.array(dr.grad(x)).sum()
    assert total == pytest.approx(found.sum(), rel=1e-2, abs=1e-3 * np.abs(found).sum())


def test_derivative_of_the_mirror() -> None:
    """Delta lobes are differentiated through their weight: d (F / p) with the chance p held."""
    bsdf = djpt.load_dict(CASES["plastic"])
    wi = np.abs(directions(14))
    eta = Float(1.5)
    dr.enable_grad(eta)
    bsdf.eta = eta
    bs, weight = bsdf.sample(BSDFContext(), interaction(wi), Float(0), Point2f(0.5))
    assert has_flag(int(np.array(bs.sampled_type)[0]), BSDFFlags.DeltaReflection)
    dr.set_grad(eta, 1)
    change = full(dr.forward_to(weight))[0] * full(bs.pdf)

    def mirror(eta: float) -> Any:
        from djpt.materials.fresnel import fresnel

        return np.array(fresnel(Float(wi[2]), Float(eta))[0], np.float64)

    np.testing.assert_allclose(change, quotient(lambda x: mirror(1.5 + x), 0.01), rtol=2e-3, atol=1e-4)


@pytest.mark.sparse(6)
@pytest.mark.parametrize(
    ("bsdf", "key", "value", "h"),
    [
        ({"type": "roughconductor", "material": "Au"}, "alpha.value", 0.4, 1e-2),
        ({"type": "roughplastic"}, "alpha", 0.4, 1e-2),
        ({"type": "roughplastic", "alpha": 0.3}, "eta", 1.5, 3e-2),
        ({"type": "roughdielectric", "alpha": 0.3}, "eta", 1.5, 5e-2),
        # The chances of the lobes change with the colour, and with them single samples: a large step.
        ({"type": "plastic"}, "diffuse_reflectance.value", 0.5, 0.2),
    ],
)
def test_derivative_of_an_image(bsdf: dict[str, Any], key: str, value: float, h: float) -> None:
    """Of a wall and what it is lit by: further bounces would move with the parameters, differences see that."""

    def back_wall(scene: dict[str, Any]) -> None:
        scene["back"]["bsdf"] = bsdf

    integrator = {"type": "prb", "max_depth": 2, "rr_depth": 100}
    scene = djpt.load_dict(box(16, integrator=integrator, edit=back_wall))
    params, key = djpt.traverse(scene), f"back.bsdf.{key}"
    params.update({key: value})
    found, expected = by_both(scene, key, h, seed=1, spp=256)
    assert found == pytest.approx(expected, rel=0.05)
