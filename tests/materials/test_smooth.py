"""Smooth metals and glass: lobe by lobe against Mitsuba and Fresnel's equations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.frame import Frame3f
from djpt.materials.fresnel import fresnel, fresnel_schlick
from djpt.materials.ior import IOR
from djpt.materials.metals import METALS
from djpt.records import BSDFContext, BSDFFlags, SurfaceInteraction3f, TransportMode
from djpt.transforms import ScalarTransform4f as T
from djpt.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.validation import agreement
from tests.kit.renders import box, ours, theirs

COUNT = 4096
GOLD = {"eta": {"type": "rgb", "value": [0.143, 0.375, 1.442]}, "k": {"type": "rgb", "value": [3.983, 2.386, 1.603]}}
TINTED = {
    "specular_reflectance": {"type": "rgb", "value": [0.9, 0.5, 0.2]},
    "specular_transmittance": {"type": "rgb", "value": [0.3, 0.6, 0.8]},
}


def interaction(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame, seen from `wi`, (3, N)."""
    z, wi = Vector3f(0, 0, 1), Vector3f(wi)
    frame = Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z)
    valid = dr.full(Bool, True, dr.width(wi))
    return SurfaceInteraction3f(
        Float(1), Point3f(0), z, frame, Point2f(0.3, 0.6), frame.s, frame.t, wi, UInt32(0), UInt32(0), valid
    )


def from_angles(*degrees: float) -> np.ndarray:
    """Directions in the plane y = 0 at angles to the normal, (3, N)."""
    angles = np.radians(degrees)
    return np.stack([np.sin(angles), 0 * angles, np.cos(angles)])


def directions(seed: int = 0) -> np.ndarray:
    """Unit vectors from all sides, (3, COUNT)."""
    w = np.random.default_rng(seed).normal(size=(3, COUNT))
    return w / np.linalg.norm(w, axis=0)


def wide(value: Any, width: int) -> np.ndarray:
    """Components (or one number) per lane as float64; what is uniform is repeated."""
    array = np.array(value, np.float64)
    return np.broadcast_to(array, (*array.shape[:-1], width)) if array.ndim else np.full(width, array)


def sampled(bsdf: Any, wi: Any, sample1: Any, mode: TransportMode = TransportMode.Radiance) -> dict[str, np.ndarray]:
    width = np.asarray(wi).shape[1]
    s1 = Float(np.broadcast_to(sample1, width).copy())
    bs, weight = bsdf.sample(BSDFContext(mode), interaction(wi), s1, Point2f(0.5, 0.5))
    found = {"wo": bs.wo, "pdf": bs.pdf, "eta": bs.eta, "type": bs.sampled_type, "weight": weight}
    found["component"] = bs.sampled_component
    return {name: wide(value, width) for name, value in found.items()}


# ---------------------------------------------------------------- as in Mitsuba

CASES: dict[str, dict[str, Any]] = {
    "conductor": {"type": "conductor"},
    "gold": {"type": "conductor", "material": "Au"},
    "index": {"type": "conductor", **GOLD, "specular_reflectance": TINTED["specular_reflectance"]},
    "eta alone": {"type": "conductor", "eta": 1.5},
    "k alone": {"type": "conductor", "k": 2.5},
    "dielectric": {"type": "dielectric"},
    "tinted": {"type": "dielectric", "int_ior": 1.8, "ext_ior": "water", **TINTED},
    "bubble": {"type": "dielectric", "int_ior": "air", "ext_ior": "Diamond"},
    "equal": {"type": "dielectric", "int_ior": 1.3, "ext_ior": 1.3},
    "thin": {"type": "thindielectric"},
    "thin, tinted": {"type": "thindielectric", "int_ior": "pet", "ext_ior": 1.0, **TINTED},
    "thin bubble": {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.5},
    "null": {"type": "null"},
}


def mitsuba() -> Any:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return mi


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


# ---------------------------------------------------------------- mirror

ANGLES = from_angles(0, 20, 50, 70, 85, 89)


def weights(description: dict[str, Any], wi: np.ndarray = ANGLES) -> np.ndarray:
    return sampled(djpt.load_dict(description), wi, 0.5)["weight"]


def test_a_plain_mirror_reflects_everything_but_only_in_front() -> None:
    found = sampled(djpt.load_dict({"type": "mirror"}), ANGLES, 0.5)
    np.testing.assert_array_equal(found["weight"], 1)
    np.testing.assert_allclose(found["wo"], ANGLES * [[-1], [-1], [1]], atol=1e-7)
    assert not weights({"type": "mirror"}, -ANGLES).any()


def test_a_mirror_of_a_metal_is_a_conductor() -> None:
    np.testing.assert_array_equal(
        weights({"type": "mirror", "material": "Cu", "reflectance": 0.5}),
        weights({"type": "conductor", "material": "Cu", "specular_reflectance": 0.5}),
    )


def test_schlicks_mirror_starts_from_its_colour() -> None:
    colour = np.array([0.9, 0.5, 0.1])[:, None]
    rgb = {"type": "rgb", "value": colour.ravel().tolist()}
    found = weights({"type": "mirror", "fresnel": "schlick", "reflectance": rgb})
    np.testing.assert_allclose(found, colour + (1 - colour) * (1 - ANGLES[2]) ** 5, atol=1e-6)


@pytest.mark.parametrize("metal", ["Au", "Ag", "Cu"])
def test_schlicks_metal_is_near_the_exact_one(metal: str) -> None:
    exact, short, flat = (
        weights({"type": "mirror", "material": metal, "fresnel": f}) for f in ("exact", "schlick", "none")
    )
    np.testing.assert_allclose(short[:, 0], exact[:, 0], atol=1e-6)
    assert 1e-3 < np.abs(short - exact).max() < 0.1
    np.testing.assert_allclose(flat, np.broadcast_to(exact[:, :1], flat.shape), atol=1e-6)


def test_parameters_of_a_mirror() -> None:
    assert list(djpt.traverse(djpt.load_dict({"type": "mirror"}))) == ["reflectance.value"]
    gold = djpt.traverse(djpt.load_dict({"type": "mirror", "material": "Au"}))
    assert sorted(gold) == ["eta.value", "k.value", "reflectance.value"]


# ---------------------------------------------------------------- glass

BOTH = np.concatenate([ANGLES, -ANGLES], axis=1)
SAMPLES = np.linspace(0, 0.999, 41)


def test_glass_is_a_dielectric() -> None:
    indices = {"int_ior": 1.5, "ext_ior": 1.0}
    for sample1 in SAMPLES:
        glass, plain = (sampled(djpt.load_dict({"type": t, **indices}), BOTH, sample1) for t in ("glass", "dielectric"))
        for name, value in plain.items():
            np.testing.assert_array_equal(glass[name], value)


@pytest.mark.parametrize(("name", "model"), [("exact", fresnel), ("schlick", fresnel_schlick)])
def test_lobes_shown_alone_add_up_to_glass(name: str, model: Any) -> None:
    base = {"type": "glass", "int_ior": 1.5, "ext_ior": 1.0, "fresnel": name}
    share, _, _, eta_ti = (x.numpy() for x in model(Float(BOTH[2]), Float(1.5)))
    reflected, refracted = {**base, "transmission": False}, {**base, "reflection": False}
    for sample1 in (0.01, 0.99):  # the lobe doesn't depend on it
        a, b = sampled(djpt.load_dict(reflected), BOTH, sample1), sampled(djpt.load_dict(refracted), BOTH, sample1)
        np.testing.assert_array_equal([a["pdf"], b["pdf"]], 1)
        np.testing.assert_array_equal(a["type"], int(BSDFFlags.DeltaReflection))
        np.testing.assert_array_equal(b["type"], int(BSDFFlags.DeltaTransmission))
        np.testing.assert_allclose(a["weight"], np.tile(share, (3, 1)), atol=1e-6)
        np.testing.assert_allclose(b["weight"], np.tile((1 - share) * eta_ti**2, (3, 1)), atol=1e-6)
    both = sampled(djpt.load_dict(base), BOTH, 0.0)
    np.testing.assert_allclose(both["pdf"], share, atol=1e-7)


def test_refraction_alone_at_equal_indices_changes_nothing() -> None:
    for model in ("exact", "schlick"):
        pane = {"type": "glass", "int_ior": 1.0, "ext_ior": 1.0, "reflection": False, "fresnel": model}
        found = sampled(djpt.load_dict(pane), BOTH, 0.5)
        np.testing.assert_allclose(found["wo"], -BOTH, atol=1e-5)
        np.testing.assert_array_equal(found["weight"], 1)
        np.testing.assert_array_equal(found["eta"], 1)


def test_equal_indices_never_reflect() -> None:
    found = sampled(djpt.load_dict({"type": "glass", "int_ior": 1.3, "ext_ior": 1.3}), BOTH, 0.0)
    np.testing.assert_array_equal(found["type"], int(BSDFFlags.DeltaTransmission))
    np.testing.assert_array_equal(found["pdf"], 1)


def test_flags_of_single_lobes() -> None:
    for missing, lobe in (("transmission", BSDFFlags.DeltaReflection), ("reflection", BSDFFlags.DeltaTransmission)):
        assert djpt.load_dict({"type": "glass", missing: False}).flags() & BSDFFlags.Delta == lobe


# ---------------------------------------------------------------- absorption, and what passes straight


@pytest.mark.parametrize("name", ["dielectric", "glass"])
def test_absorption_is_exponential(name: str) -> None:
    rgb = [0.0, 0.5, 2.0]
    bsdf = djpt.load_dict({"type": name, "absorption": {"type": "rgb", "value": rgb}})
    assert bsdf.absorbs
    distances = np.array([0.0, 0.3, 4.0, 1e4])
    found = wide(bsdf.transmittance(Float(distances)), 4)
    np.testing.assert_allclose(found, np.exp(-np.outer(rgb, distances)), rtol=1e-5)
    params = djpt.traverse(bsdf)
    assert params.flags("absorption.value") & djpt.ParamFlags.Differentiable
    params["absorption.value"] = [1, 1, 1]
    params.update()
    np.testing.assert_allclose(wide(bsdf.transmittance(Float(1.0)), 1), np.exp(-1), rtol=1e-6)


def test_clear_glass_absorbs_nothing() -> None:
    bsdf = djpt.load_dict({"type": "glass"})
    assert not bsdf.absorbs
    np.testing.assert_array_equal(wide(bsdf.transmittance(Float(5.0)), 1), 1)
    assert list(djpt.traverse(bsdf)) == ["eta"]


def test_derivative_of_absorption() -> None:
    bsdf = djpt.load_dict({"type": "dielectric", "absorption": 0.7})
    params = djpt.traverse(bsdf)
    dr.enable_grad(params["absorption.value"])
    params.update()
    dr.backward(bsdf.transmittance(Float(2.0)))
    np.testing.assert_allclose(wide(dr.grad(params["absorption.value"]), 1).ravel(), -2 * np.exp(-1.4), rtol=1e-5)


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
    h = 1e-2
    expected = (exact(1 + h) - exact(1 - h)) / (2 * h)
    assert abs(expected) > 1e-3
    assert found == pytest.approx(expected, rel=1e-2)


def test_the_index_of_bending_glass_has_no_gradient() -> None:
    params = djpt.traverse(djpt.load_dict({"type": "dielectric"}))
    assert params.flags("eta") == djpt.ParamFlags.NonDifferentiable
    assert djpt.traverse(djpt.load_dict({"type": "thindielectric"})).flags("eta") & djpt.ParamFlags.Differentiable


# ---------------------------------------------------------------- errors

ERRORS: list[tuple[dict[str, Any], str]] = [
    ({"type": "conductor", "material": "Zz"}, "'material' can't be 'Zz'; possible: Ag, Al, .*none"),
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
