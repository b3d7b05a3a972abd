"""Media by the name of a material, and by the colour of a body."""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.media.translucent import (
    albedo_of_color,
    boundary_reflectance,
    color_behind,
    reflectance_behind,
    reflectance_of_albedo,
)
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
    assert body["bsdf"]["clearcoat"] == 0.5 and body["bsdf"]["subsurface"] == 1
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
        ({"anisotropy": 0.5, "interior_color": 1.5}, r"'interior_color' must lie in \[0, 1\], found 1.5"),
        ({"material": "wax", "interior_color": 0.5}, "'interior_color' must be left out: the material has a colour"),
        ({"anisotropy": 0.5, "base_color": 1.5}, r"'base_color' must lie in \[0, 1\], found 1.5"),
        ({"material": "milk"}, "'material' must be one of .*whole_milk"),
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


def test_materials_have_their_base_color() -> None:
    """The diffuse part of a boundary has the colour of the body, so the weight doesn't change it."""
    body = djpt.subsurface(material="wax", eta=1.44)["bsdf"]
    assert body["base_color"] == body["subsurface_color"]
    np.testing.assert_allclose(body["base_color"]["value"], [0.90, 0.82, 0.66], atol=0.01)
    np.testing.assert_allclose(reflectance_of_albedo(albedo_of_color([0, 0.3, 1])), [0, 0.3, 1], atol=2e-3)
    np.testing.assert_allclose(color_behind(reflectance_behind([0, 0.3, 1], 1.4), 1.4), [0, 0.3, 1], atol=1e-12)


def ball_of(body: dict[str, Any], integrator: str = "volpath", **nodes: Any) -> Any:
    """A ball under a white sky, or what `nodes` has in its place."""
    scene = lit_ball(None, integrator=integrator, max_depth=64, rr_depth=500, size=8, **nodes)
    scene["ball"] |= body
    return scene


def patches(scene: dict[str, Any], spp: int, seeds: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """The means of the quarters of an image, and their standard errors: (2, 2, 3)."""
    loaded = djpt.load_dict(scene)
    found = np.stack([np.array(djpt.render(loaded, spp=spp, seed=seed), np.float64) for seed in range(seeds)])
    means = found.reshape(seeds, 2, 4, 2, 4, 3).mean((2, 4))
    return means.mean(0), means.std(0, ddof=1) / np.sqrt(seeds)


def checks(first: Any, second: Any) -> dict[str, Any]:
    """A texture of squares."""
    place = djpt.ScalarTransform4f().scale([3, 3, 1])
    return {"type": "checkerboard", "color0": first, "color1": second, "to_uv": place}


def side_lamp() -> dict[str, Any]:
    """A square lamp above and before the ball."""
    place = djpt.ScalarTransform4f().look_at(origin=[0, 2.5, 2.5], target=[0, 0, 0], up=[1, 0, 0])
    return {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": 1.0}}


def test_weight_blends_images() -> None:
    """A convex body that nothing else reflects light to: its image is the mixture of those of the weights 0 and 1."""
    body = partial(djpt.subsurface, [0.8, 0.5, 0.2], 1.0, interior_color=[0.7, 0.6, 0.3], metallic=0.3, clearcoat=0.5)
    (none, e_0), (entire, e_1), (some, e) = (
        patches(ball_of(body(weight=w), sky=side_lamp()), 1024, 6) for w in (0.0, 1.0, 0.3)
    )
    error = np.sqrt(e**2 + (0.7 * e_0) ** 2 + (0.3 * e_1) ** 2)
    assert np.abs(some - 0.7 * none - 0.3 * entire).max() < 5 * error.max()
    assert np.abs(entire - none).max() > 25 * error.max()


def test_textured_weight_is_white_in_a_furnace() -> None:
    """Light leaves everywhere alike: a white body is as bright as those of the weights 0 and 1, whatever the texture.

    Behind a boundary of the index 1, which reflects nothing; the diffuse lobe alone isn't exactly white.
    """
    white = partial(djpt.subsurface, 1.0, 0.1, eta=1.0, roughness=0.05)
    (mixed, e), (none, _), (entire, _) = (patches(ball_of(white(weight=w)), 256) for w in (checks(0.0, 1.0), 0.0, 1.0))
    low, high = np.minimum(none, entire), np.maximum(none, entire)
    assert (mixed > low - 4 * e - 0.004).all() and (mixed < high + 4 * e + 0.004).all()


@pytest.mark.parametrize("integrator", ["volpathmis", "bdpt"])
def test_textured_weight_is_the_same_from_both_ends(integrator: str) -> None:
    """Light paths have the adjoint of a weight that counts where paths of the camera enter."""
    colors = checks({"type": "rgb", "value": [0.8, 0.5, 0.2]}, 0.3)
    body = djpt.subsurface(colors, 0.3, weight=checks(0.9, 0.1), metallic=0.2, eta=1.3, roughness=0.3)
    lamp = side_lamp()
    expected, e_0 = patches(ball_of(body, sky=lamp), 4096, 6)
    scene = ball_of(body, sky=lamp)
    scene["integrator"] = {"type": integrator, "max_depth": 64}
    found, e_1 = patches(scene, 4096, 6)
    assert np.abs(found - expected).max() < 5 * np.hypot(e_0, e_1).max() < 0.05 * expected.max()


def wall(color: Any, half: bool) -> dict[str, Any]:
    """A thick slab under a white sky, and its colour: the texture of squares has its right half in the image."""
    scene = lit_ball(None, max_depth=1000, rr_depth=200, size=8)
    scene["ball"] = {
        "type": "cube",
        "to_world": djpt.ScalarTransform4f().scale([2, 2, 0.5]),
        **djpt.subsurface(color, 0.02, interior_color=0.6, weight=0.7, eta=1.3, roughness=0.2),
    }
    x = 1 if half else -1
    place = djpt.ScalarTransform4f().look_at(origin=[x, 0, 4], target=[x, 0, 0], up=[0, 1, 0])
    scene["sensor"] |= {"to_world": place, "fov": 10}
    return scene


@pytest.mark.parametrize("half", [False, True])
def test_textured_base_color_is_that_of_each_region(half: bool) -> None:
    """Far from the border of two colours, in free paths, each region looks like a body of one colour."""
    colors = [{"type": "rgb", "value": [0.8, 0.5, 0.2]}, {"type": "rgb", "value": [0.2, 0.3, 0.6]}]
    place = djpt.ScalarTransform4f().scale([0.5, 1, 1])
    both = {"type": "checkerboard", "color0": colors[0], "color1": colors[1], "to_uv": place}
    (found, e_0), (expected, e_1) = (patches(wall(c, half), 1024) for c in (both, colors[half]))
    other, _ = patches(wall(colors[not half], half), 64)
    assert np.abs(found - expected).max() < 5 * np.hypot(e_0, e_1).max() < 0.03
    assert np.abs(expected - other).max() > 0.2


def test_textured_base_color_is_that_of_its_own_medium() -> None:
    """The filter of a boundary gives a large body the colour that a medium would give it."""
    light = [
        light_of_ball(djpt.subsurface([0.6, 0.4, 0.2], 0.02, eta=1.0, roughness=0.05, interior_color=c), 16)
        for c in (None, 0.8)
    ]
    np.testing.assert_allclose(light[1], light[0], atol=0.015)


@pytest.mark.parametrize("name", ["base_color", "subsurface", "subsurface_color"])
def test_derivatives_of_subsurface_are_differences(name: str) -> None:
    """Path replay in reverse mode, by the colours and the weight of a boundary."""
    body = djpt.subsurface([0.8, 0.5, 0.2], 0.2, weight=0.4, interior_color=[0.7, 0.6, 0.3], eta=1.3)
    scene = djpt.load_dict(ball_of(body))
    params, key = djpt.traverse(scene), f"ball.bsdf.{name}.value"
    value, h, gradients = params[key], 0.03, []
    for seed in range(8):
        dr.enable_grad(params[key])
        params.update()
        dr.backward(dr.mean(djpt.render(scene, params=params, spp=2048, seed=seed + 1000)))
        gradients.append(float(np.array(dr.grad(params[key])).sum()))
        dr.disable_grad(params[key])
        params.update()

    def mean(offset: float, seed: int) -> float:
        params[key] = value + offset
        params.update()
        return float(np.array(djpt.render(scene, spp=8192, seed=seed), np.float64).mean())

    differences = [(mean(h, seed) - mean(-h, seed)) / (2 * h) for seed in range(4)]
    error = np.hypot(np.std(gradients, ddof=1) / np.sqrt(8), np.std(differences, ddof=1) / np.sqrt(4))
    expected = np.mean(differences)
    assert abs(np.mean(gradients) - expected) < 4 * error + 0.01 * abs(expected)
    assert error < 0.1 * abs(expected)


def test_missing_interior_is_explained() -> None:
    bsdf = {"type": "principled", "subsurface": 0.5}
    for surface in (bsdf, {"type": "mask", "opacity": 0.5, "nested": bsdf}):
        with pytest.raises(SceneError, match=r"'bsdf' has 'subsurface'.* needs an 'interior'.*djpt\.subsurface"):
            djpt.load_dict({"type": "sphere", "bsdf": surface})
    djpt.load_dict({"type": "sphere", "bsdf": bsdf, "interior": {"type": "homogeneous"}})
