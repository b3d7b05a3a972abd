"""Fresnel's equations against closed forms in double precision, and against Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

from djpt.jit.types import Color3f, Float, Float64, Vector3f
from djpt.materials.fresnel import (
    fresnel,
    fresnel_conductor,
    fresnel_diffuse_reflectance,
    fresnel_schlick,
    reflect,
    refract,
    schlick,
)

COSINES = np.cos(np.radians(np.linspace(0, 90, 181)))
GLASS = 1.5


def numbers(value: Any) -> np.ndarray:
    return np.array(value, np.float64)


def in_doubles(function: Callable[..., Any], *arguments: Any) -> Any:
    """A function of arrays, evaluated in double precision."""
    result = function(*(Float64(np.broadcast_to(a, COSINES.shape).copy()) for a in arguments))
    return [x.numpy() for x in result] if isinstance(result, tuple) else result.numpy()


def amplitudes(cos_i: Any, n: Any) -> tuple[np.ndarray, np.ndarray]:
    """Those of the waves polarised across and along the plane of incidence, for a complex index; light from outside."""
    cos_t = np.sqrt(1 - (1 - cos_i**2) / np.asarray(n, complex) ** 2)
    return (cos_i - n * cos_t) / (cos_i + n * cos_t), (n * cos_i - cos_t) / (n * cos_i + cos_t)


def reflectance(cos_i: Any, n: Any) -> np.ndarray:
    """Half the sum of the squared amplitudes."""
    s, p = amplitudes(cos_i, n)
    return (np.abs(s) ** 2 + np.abs(p) ** 2) / 2


# ---------------------------------------------------------------- dielectrics


@pytest.mark.parametrize("eta", [1.000277, 1.33, 1.5, 2.4, 1 / 1.5, 0.4])
def test_reflectance_is_the_mean_of_both_polarisations(eta: float) -> None:
    """Past the critical angle the complex amplitudes have modulus 1: total reflection is part of the formula."""
    np.testing.assert_allclose(in_doubles(fresnel, COSINES, eta)[0], reflectance(COSINES, eta), atol=1e-12)
    np.testing.assert_allclose(in_doubles(fresnel, -COSINES, 1 / eta)[0], reflectance(COSINES, eta), atol=1e-12)


def test_normal_incidence() -> None:
    for cosine in (1, -1):
        np.testing.assert_allclose(in_doubles(fresnel, cosine, GLASS)[0], ((GLASS - 1) / (GLASS + 1)) ** 2, atol=1e-14)


def test_at_brewsters_angle_one_polarisation_is_left() -> None:
    cosine = np.cos(np.arctan(GLASS))
    across = ((1 - GLASS**2) / (1 + GLASS**2)) ** 2
    np.testing.assert_allclose(in_doubles(fresnel, cosine, GLASS)[0], across / 2, atol=1e-12)


@pytest.mark.parametrize("model", [fresnel, fresnel_schlick])
def test_total_internal_reflection(model: Callable[..., Any]) -> None:
    critical = np.sqrt(1 - 1 / GLASS**2)
    below, above = (model(Float([-critical + d]), Float(GLASS)) for d in (1e-3, -1e-3))
    assert below[0][0] == 1
    assert below[1][0] == 0
    assert 0.3 < above[0][0] < 1
    assert above[1][0] > 0


@pytest.mark.parametrize("model", [fresnel, fresnel_schlick])
def test_angles_and_indices_follow_snell(model: Callable[..., Any]) -> None:
    for cosines, eta_it in ((COSINES, GLASS), (-COSINES, 1 / GLASS)):
        _, cos_t, found_it, found_ti = in_doubles(model, cosines, GLASS)
        np.testing.assert_allclose(found_it, eta_it, atol=1e-15)
        np.testing.assert_allclose(found_ti, 1 / eta_it, atol=1e-15)
        squared = 1 - (1 - cosines**2) / eta_it**2
        np.testing.assert_allclose(cos_t, -np.sign(cosines) * np.sqrt(np.maximum(squared, 0)), atol=1e-7)


@pytest.mark.parametrize("model", [fresnel, fresnel_schlick])
def test_equal_indices_reflect_nothing(model: Callable[..., Any]) -> None:
    cosines = Float([1.0, 0.5, 1e-6, 0.0, -1e-6, -1.0])
    found, cos_t, eta_it, _ = (x.numpy() for x in model(cosines, Float(1)))
    np.testing.assert_array_equal(found, 0)
    np.testing.assert_array_equal(eta_it, 1)
    np.testing.assert_allclose(cos_t, -cosines.numpy(), atol=1e-4)


def test_grazing_light_is_reflected() -> None:
    """No NaN at the horizon, from either side."""
    found = fresnel(Float([0.0, -0.0, 1e-20, -1e-20, 1e-38]), Float(GLASS))
    np.testing.assert_array_equal(found[0].numpy(), 1)
    assert np.isfinite(numbers(list(found))).all()


def test_schlick_meets_fresnel_at_both_ends() -> None:
    assert in_doubles(fresnel_schlick, 1.0, GLASS)[0][0] == pytest.approx(((GLASS - 1) / (GLASS + 1)) ** 2)
    assert in_doubles(fresnel_schlick, 0.0, GLASS)[0][0] == pytest.approx(1)
    for sign, eta in ((1, GLASS), (-1, GLASS), (1, 1 / GLASS)):
        exact, short = (in_doubles(model, sign * COSINES, eta)[0] for model in (fresnel, fresnel_schlick))
        assert np.abs(exact - short).max() < 0.05


def test_schlick_is_the_same_in_both_directions() -> None:
    """A ray and its reverse: the transmitted cosine from one side is the incident one from the other."""
    forth, cos_t, _, _ = in_doubles(fresnel_schlick, COSINES, GLASS)
    back = fresnel_schlick(Float64(cos_t), Float64(GLASS))[0].numpy()
    np.testing.assert_allclose(back, forth, atol=1e-12)


def test_schlick_of_a_colour() -> None:
    r0 = [0.9, 0.5, 0.1]
    found = numbers(schlick(Float(0.25), Color3f(r0)))[:, 0]
    np.testing.assert_allclose(found, [r + (1 - r) * 0.75**5 for r in r0], rtol=1e-6)
    # Cosines that rounding has put above 1 count as 1.
    np.testing.assert_allclose(numbers(schlick(Float(1.1), Color3f(r0)))[:, 0], r0, rtol=1e-6)


# ---------------------------------------------------------------- conductors


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (1.5, 7.0), (0, 1), (2.4, 0.3), (1.5, 0), (0.05, 0.9), (4.5, 3.0)])
def test_conductors_follow_complex_arithmetic(eta: float, k: float) -> None:
    found = in_doubles(fresnel_conductor, COSINES, eta, k)
    np.testing.assert_allclose(found, reflectance(COSINES, eta + 1j * k), atol=1e-12)
    single = fresnel_conductor(Float(COSINES), Float(eta), Float(k)).numpy()
    np.testing.assert_allclose(single, found, atol=2e-6)


def test_conductors_by_channel() -> None:
    eta, k = [0.2, 0.9, 1.1], [3.9, 2.4, 2.1]
    found = numbers(fresnel_conductor(Float(COSINES), Color3f(eta), Color3f(k)))
    expected = [reflectance(COSINES, n + 1j * x) for n, x in zip(eta, k, strict=True)]
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_conductors_are_finite_for_all_indices() -> None:
    extremes = [0.0, 1e-20, 1.0, 1e6]
    for eta in extremes:
        for k in extremes:
            found = fresnel_conductor(Float([0.0, 1e-20, 0.3, 1.0]), Float(eta), Float(k)).numpy()
            assert ((found >= 0) & (found <= 1 + 1e-6)).all(), (eta, k)


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (0.0, 1.0), (1.7, 9.2)])
@pytest.mark.parametrize("name", ["eta", "k"])
def test_derivatives_of_conductors(eta: float, k: float, name: str) -> None:
    """At eta = 0 as well, where every metal is a perfect mirror and the derivative is one-sided."""
    cosines = np.array([0.1, 0.5, 1.0])
    values = {"eta": dr.full(Float, eta, 3), "k": dr.full(Float, k, 3)}
    dr.enable_grad(values[name])
    dr.backward(fresnel_conductor(Float(cosines), **values))
    found = dr.grad(values[name]).numpy()
    h = 1e-6
    n, step = eta + 1j * k, h if name == "eta" else 1j * h
    expected = (reflectance(cosines, n + step) - reflectance(cosines, n)) / h
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-5)


# ---------------------------------------------------------------- diffuse light


@pytest.mark.parametrize(("eta", "tolerance"), [(1.05, 2e-2), (1.33, 5e-3), (1.5, 5e-3), (2.4, 5e-3), (1 / 1.33, 1e-2)])
def test_diffuse_reflectance_is_an_integral(eta: float, tolerance: float) -> None:
    """Of 2 cos R(cos) over the cosine, by the midpoint rule."""
    cosine = (np.arange(200_000) + 0.5) / 200_000
    expected = np.mean(2 * cosine * reflectance(cosine, eta))
    assert fresnel_diffuse_reflectance(Float(eta))[0] == pytest.approx(expected, rel=tolerance)


# ---------------------------------------------------------------- directions


def test_reflection_and_refraction_about_any_normal() -> None:
    rng = np.random.default_rng(4)
    w, n = rng.normal(size=(2, 3, 1000))
    w, n = w / np.linalg.norm(w, axis=0), n / np.linalg.norm(n, axis=0)
    wi, m = Vector3f(w), Vector3f(n)
    cos_i = dr.dot(wi, m)
    _, cos_t, eta_it, eta_ti = fresnel(cos_i, Float(GLASS))
    mirrored, bent = numbers(reflect(wi, m)), numbers(refract(wi, m, cos_t, eta_ti))
    np.testing.assert_allclose((mirrored * n).sum(0), (w * n).sum(0), atol=1e-6)
    np.testing.assert_allclose(np.cross(mirrored, n, axis=0), -np.cross(w, n, axis=0), atol=1e-6)
    passes = numbers(cos_t) != 0
    np.testing.assert_allclose(np.linalg.norm(bent, axis=0)[passes], 1, atol=1e-5)
    np.testing.assert_allclose((bent * n).sum(0)[passes], numbers(cos_t)[passes], atol=1e-5)
    sines = numbers(eta_it) * np.cross(bent, n, axis=0)
    np.testing.assert_allclose(sines[:, passes], -np.cross(w, n, axis=0)[:, passes], atol=1e-5)


def test_directions_about_z_are_a_special_case() -> None:
    wi, z = Vector3f(0.6, 0.0, 0.8), Vector3f(0, 0, 1)
    _, cos_t, _, eta_ti = fresnel(wi.z, Float(GLASS))
    np.testing.assert_allclose(numbers(reflect(wi)), numbers(reflect(wi, z)), atol=1e-7)
    np.testing.assert_allclose(
        numbers(refract(wi, None, cos_t, eta_ti)), numbers(refract(wi, z, cos_t, eta_ti)), atol=1e-7
    )


# ---------------------------------------------------------------- Mitsuba


def test_equal_to_mitsubas_functions() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    rng = np.random.default_rng(1)
    cosine, eta, k = (
        Float(rng.uniform(-1, 1, 20000)),
        Float(rng.uniform(0.3, 4, 20000)),
        Float(rng.uniform(0, 8, 20000)),
    )
    for ours, theirs in zip(fresnel(cosine, eta), mi.fresnel(cosine, eta), strict=True):
        np.testing.assert_allclose(ours.numpy(), theirs.numpy(), atol=1e-6)
    index = mi.Complex2f(eta, k)
    conductor = fresnel_conductor(abs(cosine), eta, k).numpy()
    np.testing.assert_allclose(conductor, mi.fresnel_conductor(abs(cosine), index).numpy(), atol=1e-5)
    diffuse = fresnel_diffuse_reflectance(eta).numpy()
    np.testing.assert_allclose(diffuse, mi.fresnel_diffuse_reflectance(eta).numpy(), atol=1e-5)
