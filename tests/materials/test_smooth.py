"""Smooth metals and glass: lobe by lobe against Mitsuba and Fresnel's equations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, BSDFFlags, TransportMode
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.materials.ior import IOR, METALS
from djpt.validation import agreement
from djpt.validation.gradcheck.losses import quotient
from tests.kit.renders import box, ours, theirs
from tests.kit.smooth_materials import (
    ANGLES,
    CASES,
    COUNT,
    GOLD,
    TINTED,
    directions,
    from_angles,
    interaction,
    mitsuba,
    sampled,
    wide,
)

# ---------------------------------------------------------------- as in Mitsuba


@pytest.mark.sparse(3)
@pytest.mark.parametrize("mode", TransportMode)
@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_samples_are_mitsubas(description: dict[str, Any], mode: TransportMode) -> None:
    mi = mitsuba()
    wi, sample1 = directions(), np.random.default_rng(1).random(COUNT).astype(np.float32)
    found = sampled(djpt.load_dict(description), wi, sample1, mode)

    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi, si.t = mi.Vector3f(wi), 1
    context = mi.BSDFContext(mi.TransportMode(int(mode)))
    bs, weight = mi.load_dict(description).sample(context, si, mi.Float(sample1), mi.Point2f(0.5))
    expected = {"wo": bs.wo, "pdf": bs.pdf, "eta": bs.eta, "type": bs.sampled_type, "weight": weight}
    expected["component"] = bs.sampled_component
    expected = {name: wide(value, COUNT) for name, value in expected.items()}

    np.testing.assert_allclose(found["weight"], expected["weight"], atol=2e-5)
    seen = expected["weight"].max(axis=0) > 0
    assert seen.mean() > 0.45
    for name in ("wo", "pdf", "eta", "type", "component"):
        np.testing.assert_allclose(found[name][..., seen], expected[name][..., seen], atol=2e-5, err_msg=name)


@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_flags_and_parameters_are_mitsubas(description: dict[str, Any]) -> None:
    mi = mitsuba()
    found, expected = djpt.load_dict(description), mi.load_dict(description)
    assert found.flags() == int(expected.flags())
    assert sorted(djpt.traverse(found)) == sorted(key for key, _ in mi.traverse(expected))
    for key, value in mi.traverse(expected):
        # A grey is one number in Mitsuba, three equal ones here.
        number = np.ravel(wide(djpt.traverse(found)[key], 1))
        np.testing.assert_allclose(number, np.broadcast_to(np.ravel(value), number.shape), rtol=1e-6)


@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_single_directions_are_never_met(description: dict[str, Any]) -> None:
    bsdf, si = djpt.load_dict(description), interaction(directions())
    for wo in (si.wi, -si.wi, Vector3f(-si.wi.x, -si.wi.y, si.wi.z)):
        value, pdf = bsdf.eval_pdf(BSDFContext(), si, wo)
        assert not wide(value, 1).any()
        assert not wide(pdf, 1).any()


@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
@pytest.mark.parametrize("sample1", [0.0, 1 - 2**-24])
def test_extreme_directions_and_samples_stay_finite(description: dict[str, Any], sample1: float) -> None:
    wi = from_angles(0, 89.9999, 90, 90.0001, 180)
    wi[2, 2] = 0
    found = sampled(djpt.load_dict(description), wi, sample1)
    for name, value in found.items():
        assert np.isfinite(value).all(), name
    assert (found["pdf"][found["weight"].max(axis=0) > 0] > 0).all()


def test_equal_seeds_give_mitsubas_pixels() -> None:
    """All of them in one box: long paths through glass, metal and a pane."""
    mitsuba()
    scene = box(48, "box", {"type": "path", "max_depth": 10})
    pane = T().translate([0, 0, 0.8]).rotate([0, 1, 0], 20).scale(0.4)
    scene["small-box"] = {"type": "sphere", "center": [0.35, -0.6, 0.3], "radius": 0.35, "bsdf": CASES["tinted"]}
    scene["large-box"]["bsdf"] = CASES["gold"]
    scene["pane"] = {"type": "rectangle", "to_world": pane, "bsdf": CASES["thin"]}
    scene["nothing"] = {"type": "sphere", "center": [-0.5, 0.5, 0.2], "radius": 0.3, "bsdf": CASES["null"]}
    assert agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 1e-3).share >= 0.998


# ---------------------------------------------------------------- tables


def test_named_media_are_mitsubas() -> None:
    mi = mitsuba()
    for name, index in IOR.items():
        bsdf = mi.load_dict({"type": "dielectric", "int_ior": name, "ext_ior": 1.0})
        assert mi.traverse(bsdf)["eta"] == pytest.approx(index, rel=1e-6), name
    with pytest.raises(Exception, match="Valid choices") as error:
        mi.load_dict({"type": "dielectric", "int_ior": "nothing"})
    names = str(error.value).split("Valid choices are:")[1].split(", ")
    assert {name.strip() for name in names} == set(IOR)


def test_named_metals_are_mitsubas() -> None:
    mi = mitsuba()
    mi.set_log_level(mi.LogLevel.Error)  # it warns of colours beyond sRGB
    for name, numbers in METALS.items():
        params = mi.traverse(mi.load_dict({"type": "conductor", "material": name}))
        for key, number in zip(("eta", "k"), numbers, strict=True):
            expected = np.broadcast_to(np.ravel(params[f"{key}.value"]), 3)
            np.testing.assert_allclose(number, expected, rtol=1e-6, err_msg=name)


def test_no_metal_of_mitsuba_is_missing() -> None:
    data = Path(mitsuba().__file__).parent / "data" / "ior"
    assert {path.name.removesuffix(".eta.spd") for path in data.glob("*.eta.spd")} | {"none"} == set(METALS)


# ---------------------------------------------------------------- what passes straight


@pytest.mark.sparse(12)
@pytest.mark.parametrize("description", CASES.values(), ids=CASES)
def test_null_transmission_is_the_null_lobe(description: dict[str, Any]) -> None:
    bsdf = djpt.load_dict(description)
    null = np.zeros((3, ANGLES.shape[1]))
    samples = (np.arange(512) + 0.5) / 512
    for sample1 in samples:
        found = sampled(bsdf, ANGLES, sample1)
        null += np.where(found["type"] == BSDFFlags.Null, found["weight"], 0) / len(samples)
    passed = wide(bsdf.eval_null_transmission(interaction(ANGLES)), ANGLES.shape[1])
    np.testing.assert_allclose(np.broadcast_to(passed, null.shape), null, atol=2e-3)


# ---------------------------------------------------------------- derivatives

DERIVATIVES: list[tuple[dict[str, Any], str]] = [
    ({"type": "conductor", **GOLD}, "eta.value"),
    ({"type": "conductor", **GOLD}, "k.value"),
    ({"type": "conductor", **GOLD, "specular_reflectance": 0.8}, "specular_reflectance.value"),
    ({"type": "mirror", "reflectance": 0.6}, "reflectance.value"),
    ({"type": "mirror", "reflectance": 0.6, "fresnel": "schlick"}, "reflectance.value"),
    ({"type": "mirror", "material": "Au", "fresnel": "schlick"}, "k.value"),
    ({"type": "dielectric", **TINTED}, "specular_reflectance.value"),
    ({"type": "dielectric", **TINTED}, "specular_transmittance.value"),
    ({"type": "thindielectric", **TINTED}, "eta"),
    ({"type": "thindielectric", **TINTED}, "specular_reflectance.value"),
    ({"type": "glass", **TINTED, "transmission": False}, "specular_reflectance.value"),
]


@pytest.mark.sparse(3)
@pytest.mark.parametrize(("description", "key"), DERIVATIVES, ids=[f"{d['type']} {k}" for d, k in DERIVATIVES])
def test_weights_have_the_derivative_of_their_expectation(description: dict[str, Any], key: str) -> None:
    """Of each lobe by itself (by its own function of the outgoing direction), averaged over `sample1`."""
    count = 2048
    sample1 = Float((np.arange(count) + 0.5) / count)
    si = interaction(np.repeat(from_angles(63), count, axis=1))

    def seen(bsdf: Any) -> Float:
        bs, weight = bsdf.sample(BSDFContext(), si, sample1, Point2f(0.5, 0.5))
        light = dr.detach(dr.select(bs.wo.z > 0, 1.0, 0.4))
        return dr.sum((weight.x + 2 * weight.y + 3 * weight.z) * light) / count

    def exact(scale: float) -> float:
        """The expectation: the weight of each lobe times its probability, without the noise of choosing."""
        bsdf = djpt.load_dict(description)
        params = djpt.traverse(bsdf)
        params[key] = params[key] * scale
        params.update()
        total = 0.0
        for s1, light in ((0.0, 1.0), (1 - 2**-24, 0.4)):
            found = sampled(bsdf, from_angles(63), s1)
            if (found["wo"][2, 0] > 0) == (light == 1.0):
                total += float(found["pdf"][0] * (found["weight"][:, 0] @ [1, 2, 3]) * light)
        return total

    bsdf = djpt.load_dict(description)
    params = djpt.traverse(bsdf)
    value = params[key]
    dr.enable_grad(value)
    params.update()
    dr.backward(seen(bsdf))
    # The derivative in the direction of the value itself.
    found = float(np.sum(wide(dr.grad(value), 1) * wide(dr.detach(value), 1)))
    expected = quotient(lambda x: exact(1 + x), 1e-2)
    assert abs(expected) > 1e-3
    assert found == pytest.approx(expected, rel=1e-2)


def test_the_index_of_bending_glass_has_no_gradient() -> None:
    params = djpt.traverse(djpt.load_dict({"type": "dielectric"}))
    assert params.flags("eta") == djpt.ParamFlags.NonDifferentiable
    assert djpt.traverse(djpt.load_dict({"type": "thindielectric"})).flags("eta").differentiable


# ---------------------------------------------------------------- errors

ERRORS: list[tuple[dict[str, Any], str]] = [
    ({"type": "conductor", "material": "Zz"}, "'material' can't be 'Zz'; possible: Ag, Al, .* and 62 more"),
    ({"type": "conductor", "material": "Cu_pali"}, "did you mean 'Cu_palik'"),
    ({"type": "conductor", "material": "Au", "k": 1.0}, "either 'material' or 'eta' and 'k', found 'material' and 'k'"),
    ({"type": "conductor", "eta": -1.0}, "'eta' must lie in"),
    ({"type": "conductor", "specular_reflectance": 1.5}, r"'specular_reflectance' must lie in \[0, 1\], found 1.5"),
    (
        {"type": "dielectric", "int_ior": "bk8"},
        r"'int_ior' must be a number or the name of a medium.*did you mean 'bk7'",
    ),
    ({"type": "dielectric", "ext_ior": 0}, "'ext_ior' must be greater than 0, found 0"),
    ({"type": "dielectric", "int_ior": [1, 2]}, "'int_ior' must be a float, found list"),
    ({"type": "thindielectric", "int_ior": -1.5}, "'int_ior' must be greater than 0, found -1.5"),
    ({"type": "thindielectric", "absorption": 1.0}, "unknown key 'absorption'"),
    ({"type": "dielectric", "eta": 1.5}, "unknown key 'eta'"),
    ({"type": "dielectric", "absorption": -1.0}, "'absorption' must be at least 0, found -1"),
    ({"type": "glass", "absorption": {"type": "checkerboard"}}, "'absorption' must be a number or an rgb colour"),
    ({"type": "glass", "reflection": False, "transmission": False}, "'reflection' and 'transmission' are both false"),
    ({"type": "glass", "fresnel": "shlick"}, "'fresnel' can't be 'shlick'; did you mean 'schlick'"),
    ({"type": "mirror", "fresnel": "yes"}, "'fresnel' can't be 'yes'; possible: exact, none, schlick"),
    ({"type": "mirror", "reflectance": 2.0}, r"'reflectance' must lie in \[0, 1\]"),
    ({"type": "null", "opacity": 1.0}, "unknown key 'opacity'"),
    ({"type": "twosided", "inner": {"type": "glass"}}, "transmitting BSDF can't be made two-sided"),
]


@pytest.mark.parametrize(("description", "message"), ERRORS, ids=[message[:30] for _, message in ERRORS])
def test_errors(description: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict(description)


@pytest.mark.parametrize("value", [0.0, -1.5, "glass", None, [1.0, 2.0]])
@pytest.mark.parametrize("name", ["dielectric", "thindielectric", "glass"])
def test_an_index_stays_positive(name: str, value: Any) -> None:
    params = djpt.traverse(djpt.load_dict({"type": name}))
    before = params["eta"][0]
    with pytest.raises(djpt.ParameterError, match=r"^eta: must be"):
        params["eta"] = value
    assert params["eta"][0] == before
    params["eta"] = 1.25
    params.update()
    assert params["eta"][0] == 1.25
