"""Phong's and Blinn's highlights, by their formulas."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, SurfaceInteraction3f
from djpt.core.warp import square_to_cosine_hemisphere, square_to_uniform_sphere
from djpt.jit.types import Float, Normal3f, Point2f, Vector3f
from tests.kit.derivatives import by_both
from tests.kit.renders import box, ours

KINDS = ("phong", "blinn")


def seen_from(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame."""
    z = Normal3f(0, 0, 1)
    frame = Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z)
    x, y = Vector3f(1, 0, 0), Vector3f(0, 1, 0)
    return SurfaceInteraction3f(t=1, n=z, sh_frame=frame, dp_du=x, dp_dv=y, wi=Vector3f(wi))


def value(bsdf: Any, wi: Any, wo: Any) -> np.ndarray:
    """f cos theta_o, (3, n)."""
    return np.array(bsdf.eval(BSDFContext(), seen_from(wi), Vector3f(wo)))


def load(kind: str, **values: Any) -> Any:
    return djpt.load_dict({"type": kind, **values})


def points(n: int = 256) -> Any:
    """A stratified grid on the unit square."""
    grid = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5) / n
    return Point2f(grid.astype(np.float32))


@pytest.mark.parametrize("kind", KINDS)
def test_values_by_the_formula(kind: str) -> None:
    rng = np.random.default_rng(0)
    wi, wo = (np.array(square_to_uniform_sphere(Point2f(rng.random((2, 512), np.float32)))) for _ in range(2))
    k_d, k_s, n = np.array([0.6, 0.2, 0.0]), np.array([0.3, 0.5, 0.9]), 7.5
    color = {name: {"type": "rgb", "value": v.tolist()} for name, v in (("diffuse", k_d), ("specular", k_s))}
    bsdf = load(kind, diffuse_reflectance=color["diffuse"], specular_reflectance=color["specular"], exponent=n)
    if kind == "phong":
        cosine = (wi * [[-1], [-1], [1]] * wo).sum(axis=0)
        factor = (n + 2) / (2 * math.pi)
    else:
        cosine = ((wi + wo) / np.linalg.norm(wi + wo, axis=0))[2]
        factor = (n + 2) * (n + 4) / (8 * math.pi * (n + 2 ** (-n / 2)))
    f = k_d[:, None] / math.pi + k_s[:, None] * factor * np.maximum(cosine, 0) ** n
    expected = np.where((wi[2] > 0) & (wo[2] > 0), f * wo[2], 0)
    np.testing.assert_allclose(value(bsdf, wi, wo), expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("exponent", [0.01, 0.5, 2.0, 10.0, 100.0, 1000.0])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(3)
def test_a_highlight_reflects_at_most_its_colour(kind: str, exponent: float) -> None:
    """All of it straight on, if the highlight is the whole material, and never more."""
    bsdf = load(kind, diffuse_reflectance=0.0, specular_reflectance=1.0, exponent=exponent)
    albedo = []
    for theta in np.radians([0, 20, 40, 60, 75, 85, 89]):
        si = seen_from([math.sin(theta), 0, math.cos(theta)])
        _, weight = bsdf.sample(BSDFContext(), si, Float(0), points())
        albedo.append(float(np.array(weight)[0].mean()))
    assert albedo[0] == pytest.approx(1, abs=2e-3)
    assert max(albedo) <= 1.002


@pytest.mark.parametrize("exponent", [0.5, 5.0, 50.0])
@pytest.mark.parametrize("kind", KINDS)
def test_samples_integrate_what_eval_says(kind: str, exponent: float) -> None:
    bsdf = load(kind, diffuse_reflectance=0.3, specular_reflectance=0.6, exponent=exponent)
    si = seen_from(np.array([0.6, -0.2, 0.5]) / np.linalg.norm([0.6, -0.2, 0.5]))
    s1 = ((np.random.default_rng(1).permutation(256**2) + 0.5) / 256**2).astype(np.float32)
    _, weight = bsdf.sample(BSDFContext(), si, Float(s1), points())
    wo = square_to_cosine_hemisphere(points())
    by_eval = np.array(bsdf.eval(BSDFContext(), si, wo) / wo.z).mean(axis=1) * math.pi
    np.testing.assert_allclose(np.array(weight).mean(axis=1), by_eval, rtol=5e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_but_numbers(kind: str) -> None:
    """Grazing, opposite and straight directions, tiny and huge exponents, black: no NaN in values and gradients."""
    special = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0.6, 0, 0.8], [-0.6, 0, -0.8], [0.6, 0, -0.8]])
    wi, wo = (np.array(a, np.float32).T for a in zip(*((a, b) for a in special for b in special), strict=True))
    for exponent, k_d, k_s in [(1e-4, 0.5, 0.5), (1e5, 0.0, 1.0), (30.0, 0.0, 0.0)]:
        bsdf = load(kind, exponent=exponent, diffuse_reflectance=k_d, specular_reflectance=k_s)
        n = bsdf.exponent.value
        dr.enable_grad(n)
        args = BSDFContext(), seen_from(wi)
        for s1 in (0.0, 0.99):
            results = bsdf.eval_pdf_sample(*args, Vector3f(wo), Float(s1), Point2f(0.0, 0.3))
            numbers = [
                np.array(dr.detach(x)) for x in (results[0], results[1], results[2].wo, results[2].pdf, results[3])
            ]
            assert all(np.isfinite(x).all() for x in numbers)
            dr.backward(dr.sum(dr.sum(results[0])), flags=dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad)
            assert np.isfinite(np.array(dr.grad(n))).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"diffuse_reflectance": 0.7, "specular_reflectance": 0.4},
            r"more than 1, found 0.7 \+ 0.4 in the red channel",
        ),
        (
            {"diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.9]}, "specular_reflectance": 0.2},
            r"found 0.9 \+ 0.2 in the blue channel",
        ),
        ({"exponent": 0.0}, "'exponent' must be greater than 0, found 0"),
        ({"exponent": -3.0}, "'exponent' must be greater than 0"),
        ({"diffuse_reflectance": 1.5}, r"'diffuse_reflectance' must lie in \[0, 1\]"),
        ({"shininess": 3.0}, "unknown key 'shininess'"),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_errors(kind: str, values: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        load(kind, **values)


@pytest.mark.parametrize("kind", KINDS)
def test_edits_that_reflect_too_much_are_taken_back(kind: str) -> None:
    params = djpt.traverse(load(kind))
    assert set(params) == {"diffuse_reflectance.value", "specular_reflectance.value", "exponent.value"}
    params["specular_reflectance.value"] = 0.6
    with pytest.raises(djpt.ParameterError, match=r"found 0.5 \+ 0.6"):
        params.update()
    assert float(np.array(params["specular_reflectance.value"]).ravel()[0]) == pytest.approx(0.2)
    params["diffuse_reflectance.value"] = 0.4
    params["specular_reflectance.value"] = 0.6
    params.update()


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", ["exponent", "specular_reflectance", "diffuse_reflectance"])
@pytest.mark.parametrize("kind", KINDS)
def test_gradients_against_differences(kind: str, name: str) -> None:
    """Light falls on a floor and a box; the directions that samples take aren't differentiated."""

    def edit(scene: dict[str, Any]) -> None:
        material = {"type": kind, "exponent": 8.0, "diffuse_reflectance": 0.4, "specular_reflectance": 0.3}
        scene["white"] = {"type": "twosided", "inner": material}

    # Emission is left to light sampling: directions depend on the exponent, and differences on the directions.
    scene = djpt.load_dict(box(16, "box", {"type": "direct", "emitter_samples": 4, "bsdf_samples": 0}, edit))
    step = 0.1 if name == "exponent" else 0.02
    found, expected = by_both(scene, f"white.brdf_0.{name}.value", step, spp=16)
    assert found == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_path_and_light_sampling_agree(kind: str) -> None:
    """Sampled directions and light samples estimate one integral."""

    def edit(scene: dict[str, Any]) -> None:
        scene["white"] = {"type": kind, "exponent": 20.0, "diffuse_reflectance": 0.3, "specular_reflectance": 0.6}

    means = [
        ours(box(16, "box", {"type": "direct", "emitter_samples": a, "bsdf_samples": b}, edit), 512).mean()
        for a, b in ((1, 0), (0, 1), (1, 1))
    ]
    np.testing.assert_allclose(means, means[0], rtol=0.02)
