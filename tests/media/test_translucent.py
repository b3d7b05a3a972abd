"""Media by the name of a material, and by the colour of a body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.media.translucent import albedo_of_color, boundary_reflectance, reflectance_behind
from tests.kit.convergence import images
from tests.kit.media_scenes import colour, fog, lit_ball


def values(**keys: Any) -> tuple[np.ndarray, np.ndarray]:
    """sigma_t and albedo of a medium."""
    medium = djpt.load_dict({"type": "homogeneous", **keys})
    return tuple(np.array(v.eval(None)).ravel() for v in (medium.sigma_t, medium.albedo))  # type: ignore[return-value]


def test_material() -> None:
    sigma_t, albedo = values(material="marble")
    np.testing.assert_allclose(sigma_t * albedo, [2.19, 2.62, 3.0], rtol=1e-5)
    np.testing.assert_allclose(sigma_t * (1 - albedo), [0.0021, 0.0041, 0.0071], rtol=2e-3)


def test_color_and_radius() -> None:
    sigma_t, albedo = values(color=colour(0.2, 0.5, 0.9), radius=colour(0.1, 0.2, 0.5))
    np.testing.assert_allclose(sigma_t, [10, 5, 2], rtol=1e-5)
    np.testing.assert_allclose(albedo, albedo_of_color([0.2, 0.5, 0.9]), rtol=1e-5)


def reflectance(albedo: float) -> float:
    """The fraction of light from all sides that a half space of evenly scattering matter sends back.

    By Chandrasekhar's function H, the solution of H = 1 + albedo / 2 mu H(mu) integral of H(x) / (mu + x) dx.
    """
    x, weight = np.polynomial.legendre.leggauss(64)
    mu, weight = (x + 1) / 2, weight / 2
    h = np.ones_like(mu)
    for _ in range(2000):
        h = 1 / (np.sqrt(1 - albedo) + albedo / 2 * ((mu * h * weight)[None] / (mu[:, None] + mu[None])).sum(1))
    return float(1 - 2 * np.sqrt(1 - albedo) * (h * mu * weight).sum())


@pytest.mark.parametrize("color", [0.05, 0.2, 0.5, 0.8, 0.95])
def test_body_has_the_color(color: float) -> None:
    """The closed form of a half space with the albedo of a colour has that colour."""
    assert reflectance(float(albedo_of_color(color))) == pytest.approx(color, abs=0.01)


def test_asymmetry_reduces_coefficients() -> None:
    """Absorption stays, scattering is (1 - g) times as frequent; two descriptions of one thing are refused."""
    sigma_t, albedo = values(sigma_t=colour(24, 26, 30), albedo=colour(0.9, 0.5, 0.0), asymmetry=0.7)
    np.testing.assert_allclose(sigma_t * (1 - albedo), [2.4, 13, 30], rtol=1e-5)
    np.testing.assert_allclose(sigma_t * albedo, [0.3 * 21.6, 0.3 * 13, 0], rtol=1e-5)
    np.testing.assert_allclose(values(asymmetry=0.0)[0], 1)
    with pytest.raises(SceneError, match="takes the place of a phase function"):
        values(asymmetry=0.5, phase={"type": "hg"})
    with pytest.raises(SceneError, match=r"'asymmetry'.*'material'"):
        values(asymmetry=0.5, material="marble")


@pytest.mark.slow
def test_asymmetry_looks_the_same() -> None:
    """A dense ball that scatters forward under a white sky, and what is similar to it."""
    dense = fog(30.0, 0.995)
    plugin = {"type": "volpath", "max_depth": 400, "rr_depth": 400}
    forward = np.stack(images(lit_ball({**dense, "phase": {"type": "hg", "g": 0.7}}), plugin, 256))
    even = np.stack(images(lit_ball({**dense, "asymmetry": 0.7}), plugin, 256, 100))
    centre = (slice(None), slice(6, 10), slice(6, 10))
    assert even[centre].mean() == pytest.approx(forward[centre].mean(), rel=0.02)


def test_forward_scattering_is_similar() -> None:
    """(1 - g) albedo / (1 - g albedo) is the albedo of matter that scatters evenly and looks the same."""
    g = 0.7
    forward, even = albedo_of_color(0.6, g), albedo_of_color(0.6)
    assert (1 - g) * forward / (1 - g * forward) == pytest.approx(float(even))


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"material": "whole_mlik"}, "did you mean 'whole_milk'"),
        ({"material": "cream", "albedo": 0.5}, "and 'albedo' set the same property"),
        ({"color": 0.5, "sigma_t": 2.0}, "and 'sigma_t' set the same property"),
        ({"color": 1.5}, "color"),
        ({"color": 0.5, "radius": 0.0}, "must be positive"),
        ({"radius": 1.0}, "belongs to a 'color'"),
        ({"material": "cream", "boundary_eta": 1.4}, "belongs to a 'color'"),
        ({"color": 0.5, "boundary_eta": 0.9}, "boundary_eta"),
    ],
    ids=str,
)
def test_what_is_refused(keys: dict[str, Any], problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        values(**keys)


# ---------------------------------------------------------------- behind a boundary


@pytest.mark.parametrize("eta", [1.0, 1.001, 1.33, 1.5, 2.4])
def test_reflectance_of_a_boundary(eta: float) -> None:
    """The closed form is the integral of Fresnel's reflectance, from either side."""
    x, weight = np.polynomial.legendre.leggauss(2000)
    for n in (eta, 1 / eta):
        cos, w = (x + 1) / 2, weight / 2
        inside = np.sqrt(np.maximum(1 - (1 - cos**2) / n**2, 0))
        s, p = (cos - n * inside) / (cos + n * inside), (inside - n * cos) / (inside + n * cos)
        integral = float((w * cos * (s**2 + p**2)).sum())
        closed = boundary_reflectance(eta) if n >= 1 else 1 - (1 - boundary_reflectance(eta)) / eta**2
        assert closed == pytest.approx(integral, abs=2e-4)


def test_reflectance_behind_a_boundary() -> None:
    """White and black matter are that behind any boundary; else the series of reflections gives the colour again."""
    np.testing.assert_allclose(reflectance_behind([0.0, 1.0], 1.5), [0, 1])
    np.testing.assert_allclose(reflectance_behind([0.3, 0.8], 1.0), [0.3, 0.8])
    inside = 1 - (1 - boundary_reflectance(1.5)) / 2.25
    r = reflectance_behind(0.6, 1.5)
    assert sum((1 - inside) * r * (inside * r) ** k for k in range(60)) == pytest.approx(0.6, abs=1e-6)


def light_of_ball(body: dict[str, Any], size: int) -> np.ndarray:
    """The fraction of the light of a white sky that the unit ball returns, by channel; by `size` x `size` pixels.

    Parallel rays see it in a square of the side 2.
    """
    scene = {
        "type": "scene",
        "integrator": {"type": "volpathmis", "max_depth": 2000, "rr_depth": 2000},
        "sky": {"type": "constant"},
        "ball": {"type": "sphere", **body},
        "sensor": {
            "type": "orthographic",
            "to_world": djpt.ScalarTransform4f().look_at(origin=[0, 0, 6], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
    }
    mean = np.array(djpt.render(djpt.load_dict(scene), spp=128)).mean((0, 1))
    found: np.ndarray = 1 - (1 - mean) / (np.pi / 4)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("eta", [1.0, 1.4])
def test_body_has_the_color_behind_a_boundary(eta: float) -> None:
    """The whole light of a large ball under a white sky: what its boundary reflects, and the colour of the rest."""
    color = [0.85, 0.5, 0.2]
    bsdf = {"type": "null"} if eta == 1 else {"type": "dielectric", "int_ior": eta, "ext_ior": 1.0}
    medium = {"type": "homogeneous", "color": colour(*color), "radius": 0.02, "boundary_eta": eta}
    ball = light_of_ball({"bsdf": bsdf, "interior": medium}, 32)
    reflected = boundary_reflectance(eta)
    np.testing.assert_allclose((ball - reflected) / (1 - reflected), color, atol=0.05)


def test_subsurface() -> None:
    """A body is described by a colour and a radius, or by a material; what is fixed can't be given."""
    body = djpt.subsurface([0.8, 0.5, 0.3], [1.0, 0.3, 0.1], scale=0.05, clearcoat=0.5)
    assert body["bsdf"]["clearcoat"] == 0.5 and body["bsdf"]["spec_trans"] == 1
    medium = djpt.load_dict(body["interior"])
    np.testing.assert_allclose(np.array(medium.sigma_t.eval(None)).ravel(), [1, 1 / 0.3, 10], rtol=1e-5)
    assert medium.scale[0] == pytest.approx(20)
    expected = albedo_of_color(reflectance_behind([0.8, 0.5, 0.3], 1.4))
    np.testing.assert_allclose(np.array(medium.albedo.eval(None)).ravel(), expected, rtol=1e-5)
    skin = djpt.load_dict(djpt.subsurface(material="skin_1", scale=0.1)["interior"])
    np.testing.assert_allclose(np.array(skin.sigma_t.eval(None)).ravel(), [0.772, 1.05, 1.49], rtol=1e-4)
    assert skin.scale[0] == pytest.approx(10)


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"spec_trans": 0.5}, "'spec_trans' is fixed"),
        ({"specular": 0.5}, "give 'eta' in place of 'specular'"),
        ({"anisotropy": 1.0}, r"'anisotropy' must lie in \(-1, 1\), found 1.0"),
        ({"anisotropy": 0.5, "radius": [1.0, 0.0, 1.0]}, "'radius' must be positive"),
        ({"anisotropy": 0.5, "base_color": 1.5}, r"'base_color' must lie in \[0, 1\], found 1.5"),
        ({"anisotropy": 0.5, "material": "milk"}, "'material' must be one of .*whole_milk"),
    ],
    ids=str,
)
def test_what_subsurface_refuses(keys: dict[str, Any], problem: str) -> None:
    with pytest.raises(SceneError, match=problem):
        djpt.subsurface(**keys)


@pytest.mark.parametrize("g", [0.0, 0.6])
def test_subsurface_has_its_base_color(g: float) -> None:
    """The whole light of a large ball under a white sky, at a boundary that reflects next to nothing."""
    color = [0.8, 0.5, 0.2]
    body = djpt.subsurface(color, 0.01, eta=1.0, roughness=0.05, anisotropy=g)
    ball = light_of_ball(body, 16)
    np.testing.assert_allclose(ball, color, atol=0.012)


def test_anisotropy_is_the_inverse_of_asymmetry() -> None:
    """What is reduced again scatters evenly as the material does."""
    interior = djpt.subsurface(material="wax", anisotropy=0.7)["interior"]
    assert interior.pop("phase") == {"type": "hg", "g": 0.7}
    found, expected = (
        djpt.load_dict({**interior, "asymmetry": 0.7}),
        djpt.load_dict(djpt.subsurface(material="wax")["interior"]),
    )
    for name in ("sigma_t", "albedo"):
        a, b = (np.array(getattr(medium, name).eval(None)).ravel() for medium in (found, expected))
        np.testing.assert_allclose(a, b, rtol=1e-5)


def test_wax_has_its_color() -> None:
    """The closed form of a half space, behind a boundary of the index 1.44, and the free path of half a millimetre."""
    sigma_t, albedo = values(material="wax")
    np.testing.assert_allclose(sigma_t, 2, rtol=5e-3)
    body = [reflectance(float(a)) for a in albedo]
    np.testing.assert_allclose(body, reflectance_behind([0.90, 0.82, 0.66], 1.44), atol=0.01)


def test_wax_is_rendered() -> None:
    """A thick candle of wax is pale yellow."""
    scene = lit_ball(None, rr_depth=500, max_depth=500)
    scene["ball"] |= djpt.subsurface(material="wax", scale=0.02, eta=1.44)
    red, green, blue = np.array(djpt.render(djpt.load_dict(scene), spp=16))[6:10, 6:10].mean((0, 1))
    assert 1 > red > green > blue > 0.4


def test_subsurface_is_white_in_a_furnace() -> None:
    """Behind a smooth boundary, matter of the colour 1 can't be seen under a white sky."""
    scene = lit_ball(fog(1.0, 1.0))
    name = next(key for key, value in scene.items() if isinstance(value, dict) and "interior" in value)
    scene[name] |= djpt.subsurface(1.0, 0.2, roughness=0.05)
    image = np.stack(images(scene, {"type": "volpath", "max_depth": 1000, "rr_depth": 1000}, 64))
    assert image[:, 6:10, 6:10].mean() == pytest.approx(1, abs=0.03)
