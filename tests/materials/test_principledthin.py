"""Disney's principled material for sheets: Mitsuba's numbers, its own samples, gradients and errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.dispatch.ensemble import structure
from djpt.jit.types import Vector3f
from djpt.validation import agreement
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
    "spec_trans": 0.6, "diff_trans": 0.8, "anisotropic": 0.3, "spec_tint": 0.7, "sheen": 0.4, "sheen_tint": 0.3,
    "flatness": 0.5, "eta": 1.3, "roughness": 0.5,
}  # fmt: skip

SETS: dict[str, dict[str, Any]] = {
    "defaults": {},
    "specular": {"spec_trans": 1.0, "roughness": 0.5},
    "anisotropic": {"spec_trans": 0.5, "anisotropic": 0.8, "roughness": 0.6},
    "all through": {"diff_trans": 2.0},
    "sheen": {"sheen": 1.0},
    "tinted sheen": {"diff_trans": 0.7, "sheen": 0.6, "sheen_tint": 0.5},
    "flat": {"flatness": 0.8, "roughness": 0.9, "diff_trans": 1.0},
    "tinted": {"spec_trans": 0.7, "spec_tint": 1.0, "eta": 0.8},
    "matched": {"spec_trans": 0.7, "eta": 1.0},
    "everything": EVERYTHING,
    "rates": {
        "spec_trans": 0.5,
        "diff_trans": 1.2,
        "specular_reflectance_sampling_rate": 0.3,
        "specular_transmittance_sampling_rate": 2.0,
        "diffuse_transmittance_sampling_rate": 0.5,
        "diffuse_reflectance_sampling_rate": 0.9,
    },
}
SMOOTH: dict[str, dict[str, Any]] = {"polished": {"roughness": 0.0, "spec_trans": 0.6}}
CASES = [pytest.param(values, id=name) for name, values in {**SETS, **SMOOTH}.items()]


def described(values: dict[str, Any]) -> dict[str, Any]:
    return {"type": "principledthin", "base_color": COLOR, **values}


@MODES
@pytest.mark.parametrize("values", CASES)
def test_values_are_mitsubas(values: dict[str, Any], mode: int) -> None:
    compare_values(described(values), mode)


@pytest.mark.sparse(3)
@MODES
@pytest.mark.parametrize("values", CASES)
def test_samples_are_mitsubas(values: dict[str, Any], mode: int) -> None:
    compare_samples(described(values), mode, smooth=values in SMOOTH.values())


def test_parameters_and_their_defaults_are_mitsubas() -> None:
    bsdf, reference = load_both({"type": "principledthin"})
    found, wanted = djpt.traverse(bsdf), mi.traverse(reference)
    assert set(found) == {key for key, _ in wanted.items()}
    for key in found:
        assert np.unique(np.array(found[key])) == pytest.approx(np.unique(np.array(wanted[key])))


def test_an_image_has_mitsubas_pixels() -> None:
    description = box(48, "box", {"type": "path", "max_depth": 6})
    # The small box stands on the floor: from within, two surfaces are at the same place.
    description["small-box"] = {"type": "sphere", "center": [0.3, -0.6, 0.4], "radius": 0.35}
    description["small-box"]["bsdf"] = described(EVERYTHING)
    description["large-box"]["bsdf"] = described(SETS["all through"])
    assert agreement(ours(description, 8), theirs(description, 8), 1e-3).share >= 0.99


@pytest.mark.sparse(18)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("values", [pytest.param(v, id=name) for name, v in SETS.items()])
def test_samples_follow_the_density(values: dict[str, Any], wi: Any) -> None:
    # Rough enough for the quadrature: transmission is smoother than reflection.
    follows_its_density(described({**values, "roughness": 1.0, "eta": 1.5}), wi)


@pytest.mark.parametrize("values", [EVERYTHING, {**EVERYTHING, "eta": 0.8}], ids=["denser", "thinner"])
def test_values_have_the_right_gradients(values: dict[str, Any]) -> None:
    check_gradients(described(values))


@pytest.mark.parametrize("values", [{}, {"diff_trans": 0.5}, EVERYTHING])
def test_flags_are_mitsubas(values: dict[str, Any]) -> None:
    bsdf, reference = load_both(described(values))
    assert bsdf.flags() == reference.flags()


def test_both_sides_are_alike() -> None:
    bsdf = djpt.load_dict(described(EVERYTHING))
    wi, wo = directions(1024, 1), directions(1024, 2)
    one, other = bsdf_value(bsdf, seen_from(wi), Vector3f(wo)), bsdf_value(bsdf, seen_from(-wi), Vector3f(-wo))
    np.testing.assert_array_equal(one, other)


@pytest.mark.sparse(20)
@pytest.mark.parametrize("color", [0.0, 1.0])
@pytest.mark.parametrize("eta", [1e-3, 1.0, 20.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_nothing_is_undefined_at_the_ends(share: float, eta: float, color: float) -> None:
    for roughness, anisotropic in ((0.0, 1.0), (1.0, 0.0)):
        numbers = dict.fromkeys(EVERYTHING, 1.0) | {"spec_trans": share, "diff_trans": 2 - 2 * share, "eta": eta}
        numbers |= {"roughness": roughness, "anisotropic": anisotropic}
        # A texture of its own switches a lobe on although it is 0.
        on = {key: {"type": "uniform", "value": value} for key, value in numbers.items()}
        stays_finite({"type": "principledthin", **on, "base_color": color})


def test_without_any_sampling_nothing_is_sampled() -> None:
    kinds = ("specular_reflectance", "specular_transmittance", "diffuse_reflectance", "diffuse_transmittance")
    stays_finite(described({**{f"{kind}_sampling_rate": 0.0 for kind in kinds}, "spec_trans": 0.5, "diff_trans": 1.0}))


def test_parameters_of_zero_are_left_out_of_kernels() -> None:
    off = {key: 0.0 for key in EVERYTHING if key not in ("eta", "roughness")}
    plain = djpt.load_dict({"type": "principledthin"})
    assert structure(djpt.load_dict({"type": "principledthin", **off})) == structure(plain)
    assert structure(djpt.load_dict({"type": "principledthin", "diff_trans": 0.1})) != structure(plain)


@pytest.mark.parametrize("key", ["spec_trans", "diff_trans", "sheen", "flatness"])
def test_an_edit_turns_a_lobe_on(key: str) -> None:
    edited, given = djpt.load_dict(described({})), djpt.load_dict(described({key: 0.7}))
    params = djpt.traverse(edited)
    params[f"{key}.value"] = 0.7
    params.update()
    si, wo = seen_from(directions(256, 1)), Vector3f(directions(256, 2))
    value = bsdf_value(edited, si, wo)
    np.testing.assert_array_equal(value, bsdf_value(given, si, wo))
    assert not np.allclose(value, bsdf_value(djpt.load_dict(described({})), si, wo))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"diff_trans": 2.5}, r"'diff_trans' must lie in \[0, 2\], found 2.5"),
        ({"spec_trans": 1.5}, r"'spec_trans' must lie in \[0, 1\]"),
        ({"eta": 0.0}, "'eta' must be greater than 0"),
        ({"specular_transmittance_sampling_rate": -1.0}, "must be at least 0"),
        ({"metallic": 0.5}, "unknown key 'metallic'"),
    ],
)
def test_wrong_descriptions_are_explained(values: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "principledthin", **values})


def test_wrong_edits_are_explained() -> None:
    params = djpt.traverse(djpt.load_dict({"type": "principledthin"}))
    with pytest.raises(djpt.ParameterError, match="at least 0"):
        params["diffuse_reflectance_sampling_rate"] = -1.0
