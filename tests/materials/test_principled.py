"""Disney's principled material: Mitsuba's numbers, its own samples, gradients and errors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext
from djpt.dispatch.ensemble import structure
from djpt.jit.types import Point2f, Vector3f
from djpt.validation import agreement
from tests.kit.chi_squared import uniform
from tests.kit.disney import (
    COLOR,
    MODES,
    WI,
    bsdf_value,
    check_gradients,
    compare_samples,
    compare_values,
    directions,
    follows_its_density,
    load_both,
    seen_from,
    stays_finite,
)
from tests.kit.renders import box, ours, theirs

mi = pytest.importorskip("mitsuba")


EVERYTHING = {
    "spec_trans": 0.6, "metallic": 0.3, "clearcoat": 0.5, "clearcoat_gloss": 0.2, "sheen": 0.4, "sheen_tint": 0.3,
    "anisotropic": 0.5, "spec_tint": 0.4, "flatness": 0.3, "specular": 0.7, "roughness": 0.45,
}  # fmt: skip

OPAQUE: dict[str, dict[str, Any]] = {
    "defaults": {},
    "metal": {"metallic": 1.0, "roughness": 0.5},
    "anisotropic": {"anisotropic": 0.8, "metallic": 0.6, "roughness": 0.5},
    "coated": {"clearcoat": 1.0, "clearcoat_gloss": 0.0},
    "sheen": {"sheen": 1.0},
    "tinted sheen": {"sheen": 1.0, "sheen_tint": 0.6, "metallic": 0.2},
    "flat": {"flatness": 0.7, "roughness": 0.8},
    "tinted": {"spec_tint": 0.7, "specular": 0.9},
    "no interface": {"specular": 0.0},
    "rates": {
        "main_specular_sampling_rate": 0.3,
        "clearcoat_sampling_rate": 4.0,
        "diffuse_reflectance_sampling_rate": 0.7,
        "clearcoat": 0.7,
    },
}
CLEAR: dict[str, dict[str, Any]] = {
    "glass": {"spec_trans": 1.0, "eta": 1.5, "roughness": 0.4},
    "thinner inside": {"spec_trans": 0.8, "eta": 0.7, "roughness": 0.6, "metallic": 0.1, "spec_tint": 0.5},
    "everything": EVERYTHING,
}
SMOOTH: dict[str, dict[str, Any]] = {
    "polished metal": {"roughness": 0.0, "anisotropic": 1.0, "metallic": 0.5},
    "polished glass": {"roughness": 0.0, "spec_trans": 0.9},
    "glossy coat": {"clearcoat": 0.4, "clearcoat_gloss": 1.0},
    "matched": {"spec_trans": 0.5, "eta": 1.0},
    "nearly matched": {"spec_trans": 0.4, "specular": 0.0},
}
"""Peaks so narrow that they follow from differences of nearly equal numbers."""


# ---------------------------------------------------------------- the same in both renderers


CASES = [pytest.param(values, id=name) for name, values in {**OPAQUE, **CLEAR, **SMOOTH}.items()]


def described(values: dict[str, Any]) -> dict[str, Any]:
    return {"type": "principled", "base_color": COLOR, **values}


@pytest.mark.sparse(3)
@MODES
@pytest.mark.parametrize("values", CASES)
def test_values_are_mitsubas(values: dict[str, Any], mode: int) -> None:
    # Mitsuba's pdf of an opaque material isn't 0 from behind, where it never samples.
    clear = "spec_trans" in values
    compare_values(described(values), mode, sides=True if clear else lambda wi: wi[2] > 0)


@pytest.mark.sparse(9)
@MODES
@pytest.mark.parametrize("values", CASES)
def test_samples_are_mitsubas(values: dict[str, Any], mode: int) -> None:
    compare_samples(described(values), mode, smooth=values in SMOOTH.values())


def test_parameters_and_their_defaults_are_mitsubas() -> None:
    for values in ({}, {"eta": 1.4}):
        bsdf, reference = load_both({"type": "principled", **values})
        found, wanted = djpt.traverse(bsdf), mi.traverse(reference)
        assert set(found) == {key for key, _ in wanted.items()}
        for key in found:
            assert np.unique(np.array(found[key])) == pytest.approx(np.unique(np.array(wanted[key])))


def test_an_image_has_mitsubas_pixels() -> None:
    description = box(48, "box", {"type": "path", "max_depth": 6})
    # The small box stands on the floor: from within, two surfaces are at the same place.
    description["small-box"] = {"type": "sphere", "center": [0.3, -0.6, 0.4], "radius": 0.35}
    description["small-box"]["bsdf"] = described(EVERYTHING)
    description["large-box"]["bsdf"] = {"type": "twosided", "inner": described(OPAQUE["coated"])}
    assert agreement(ours(description, 8), theirs(description, 8), 1e-3).share >= 0.99


# ---------------------------------------------------------------- sampling


@pytest.mark.sparse(20)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("values", [pytest.param(v, id=name) for name, v in {**OPAQUE, **CLEAR}.items()])
def test_samples_follow_the_density(values: dict[str, Any], wi: Any) -> None:
    follows_its_density(described(values), wi, fine=96 if "clearcoat" in values else 32)


# ---------------------------------------------------------------- gradients


GRADIENT_CASES = {
    "everything": EVERYTHING,
    "thinner inside": {**EVERYTHING, **CLEAR["thinner inside"]},
    "opaque": {key: value for key, value in EVERYTHING.items() if key != "spec_trans"},
}
del GRADIENT_CASES["thinner inside"]["specular"]


@pytest.mark.parametrize("values", GRADIENT_CASES.values(), ids=GRADIENT_CASES)
@pytest.mark.sparse(2)
def test_values_have_the_right_gradients(values: dict[str, Any]) -> None:
    check_gradients(described(values), off=() if "spec_trans" in values else ("spec_trans",))


def test_the_weight_of_a_sample_has_the_gradient_of_its_value() -> None:
    bsdf = djpt.load_dict(described(EVERYTHING))
    si, (s1, x, y) = seen_from(directions(512, 5)), uniform(512, 3, seed=6)
    params = djpt.traverse(bsdf)
    for key in ("roughness.value", "metallic.value", "specular", "clearcoat_gloss.value"):
        dr.enable_grad(params[key])
        params.update()
        bs, weight = bsdf.sample(BSDFContext(), si, s1, Point2f(x, y))
        assert not dr.grad_enabled(bs.wo)
        assert not dr.grad_enabled(bs.pdf)
        dr.set_grad(params[key], 1)
        found = np.array(dr.forward_to(weight), np.float64)
        value = bsdf.eval(BSDFContext(), si, bs.wo)
        dr.set_grad(params[key], 1)
        wanted = np.array(dr.forward_to(value), np.float64)
        lit = np.array(weight).max(axis=0) > 0
        np.testing.assert_allclose((found * np.array(bs.pdf))[:, lit], wanted[:, lit], rtol=1e-3, atol=1e-3)
        dr.disable_grad(params[key])
        params.update()


# ---------------------------------------------------------------- ends of all ranges


ENDS: list[dict[str, Any]] = [
    dict(zip(EVERYTHING, numbers, strict=True))
    for numbers in (
        [0.0] * 11, [1.0] * 11, [0.0, 1.0] * 5 + [0.0], [1.0, 0.0] * 5 + [1.0],
        [0.5] * 10 + [0.0], [0.5] * 9 + [0.0, 1.0], [1.0, 0.0, 1.0, 1.0] + [1.0] * 6 + [0.0],
    )
]  # fmt: skip


@pytest.mark.sparse(24)
@pytest.mark.parametrize("color", [0.0, 1.0, [1.0, 0.0, 0.0]])
@pytest.mark.parametrize("values", ENDS)
@pytest.mark.slow
def test_nothing_is_undefined_at_the_ends(values: dict[str, Any], color: Any) -> None:
    # A texture of its own switches a lobe on although it is 0.
    on = {key: {"type": "uniform", "value": v} if key != "specular" else v for key, v in values.items()}
    base_color = {"type": "rgb", "value": color} if isinstance(color, list) else color
    stays_finite({"type": "principled", **on, "base_color": base_color})


@pytest.mark.sparse(4)
@pytest.mark.parametrize("eta", [1e-3, 1.0, 20.0])
@pytest.mark.slow
def test_nothing_is_undefined_for_odd_interfaces(eta: float) -> None:
    values = {key: value for key, value in EVERYTHING.items() if key != "specular"}
    stays_finite(described({**values, "eta": eta}))
    stays_finite(described({"eta": eta, "roughness": 0.0, "metallic": 0.5, "spec_tint": 1.0}))


@pytest.mark.slow
def test_without_any_sampling_nothing_is_sampled() -> None:
    rates = {f"{name}_sampling_rate": 0.0 for name in ("main_specular", "clearcoat", "diffuse_reflectance")}
    stays_finite(described({**rates, "clearcoat": 0.5}))


# ---------------------------------------------------------------- lobes that are off


def test_parameters_of_zero_are_left_out_of_kernels() -> None:
    off = {key: 0.0 for key in EVERYTHING if key not in ("specular", "roughness", "clearcoat_gloss")}
    plain = djpt.load_dict({"type": "principled"})
    assert structure(djpt.load_dict({"type": "principled", **off})) == structure(plain)
    assert structure(djpt.load_dict({"type": "principled", "sheen": 0.1})) != structure(plain)
    assert structure(djpt.load_dict({"type": "principled", "eta": 1.5})) != structure(plain)


@pytest.mark.parametrize(
    "key", ["spec_trans", "clearcoat", "sheen", "metallic", "anisotropic", "flatness", "spec_tint"]
)
def test_an_edit_turns_a_lobe_on(key: str) -> None:
    edited, given = djpt.load_dict(described({})), djpt.load_dict(described({key: 0.7}))
    params = djpt.traverse(edited)
    params[f"{key}.value"] = 0.7
    params.update()
    si, wo = seen_from(directions(256, 1)), Vector3f(directions(256, 2))
    value = bsdf_value(edited, si, wo)
    np.testing.assert_array_equal(value, bsdf_value(given, si, wo))
    assert not np.allclose(value, bsdf_value(djpt.load_dict(described({})), si, wo))
    assert edited.flags() == given.flags()


def test_an_edit_turns_a_lobe_on_in_one_of_several_materials() -> None:
    def described_box(values: dict[str, Any]) -> dict[str, Any]:
        description = box(16, "box", {"type": "path", "max_depth": 2})
        description["small-box"]["bsdf"] = described({})
        description["large-box"]["bsdf"] = described(values)
        return description

    scene = djpt.load_dict(described_box({}))
    params = djpt.traverse(scene)
    params["large-box.bsdf.clearcoat.value"] = 0.8
    params.update()
    edited = np.array(djpt.render(scene, spp=1))
    np.testing.assert_allclose(edited, ours(described_box({"clearcoat": 0.8}), 1), rtol=1e-5)


@pytest.mark.parametrize("values", [{}, {"anisotropic": 0.5}, {"clearcoat": 0.5}, {"spec_trans": 0.5}, EVERYTHING])
def test_flags_are_mitsubas(values: dict[str, Any]) -> None:
    bsdf, reference = load_both(described(values))
    assert bsdf.flags() == reference.flags()


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"eta": 1.5, "specular": 0.5}, "'eta' and 'specular' set the same property"),
        ({"specular": 1.5}, r"'specular' must lie in \[0, 1\], found 1.5"),
        ({"eta": 0.0}, "'eta' must be greater than 0"),
        ({"roughness": -0.1}, r"'roughness' must lie in \[0, 1\]"),
        ({"metallic": 1.2}, r"'metallic' must lie in \[0, 1\]"),
        ({"clearcoat_sampling_rate": -1.0}, "'clearcoat_sampling_rate' must be at least 0"),
        ({"clearcoat_glass": 0.5}, "'clearcoat_glass'.*clearcoat_gloss"),
        ({"subsurface": 1.5}, r"'subsurface' must lie in \[0, 1\], found 1.5"),
        ({"subsurface": 0.5, "spec_trans": 0.5}, "'subsurface' and 'spec_trans' can't be combined: .* one medium"),
        ({"subsurface_color": 0.5}, "'subsurface_color' belongs to 'subsurface'"),
        ({"subsurface_radius": 0.1}, r"'subsurface_radius' isn't a parameter.*djpt\.subsurface"),
        ({"sheen": "much"}, "'sheen' must be a number or a texture"),
    ],
)
def test_wrong_descriptions_are_explained(values: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "principled", **values})


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("specular", 1.1, r"lie in \[0, 1\]"),
        ("specular", -0.1, r"lie in \[0, 1\]"),
        ("clearcoat.value", 2.0, r"lie in \[0, 1\]"),
        ("main_specular_sampling_rate", -1.0, "at least 0"),
    ],
)
def test_wrong_edits_are_explained(key: str, value: float, message: str) -> None:
    params = djpt.traverse(djpt.load_dict({"type": "principled"}))
    with pytest.raises(djpt.ParameterError, match=message):
        params[key] = value
