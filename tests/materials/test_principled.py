"""Disney's principled material: Mitsuba's numbers, its own samples, gradients and errors."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.dispatch.ensemble import structure
from djpt.frame import Frame3f
from djpt.records import BSDFContext, SurfaceInteraction3f, TransportMode
from djpt.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.validation import agreement
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, p_value, uniform
from tests.kit.renders import box, ours, theirs

mi = pytest.importorskip("mitsuba")

COUNT = 8192
COLOR = {"type": "rgb", "value": [0.8, 0.3, 0.1]}

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


def directions(count: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(3, count))
    return (v / np.linalg.norm(v, axis=0)).astype(np.float32)


def seen_from(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame; `wi` are the columns of (3, n)."""
    z, wi = Vector3f(0, 0, 1), Vector3f(np.asarray(wi, np.float32))
    return SurfaceInteraction3f(
        t=Float(1),
        p=Point3f(0),
        n=z,
        sh_frame=Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z),
        uv=Point2f(0.3, 0.6),
        dp_du=Vector3f(1, 0, 0),
        dp_dv=Vector3f(0, 1, 0),
        wi=wi,
        shape_index=UInt32(0),
        face=UInt32(0),
        valid=dr.full(Bool, True, dr.width(wi)),
    )


def mitsubas_point(wi: np.ndarray) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, wi.shape[1])
    si.wi, si.uv = mi.Vector3f(wi), mi.Point2f(0.3, 0.6)
    return si


def load_both(description: dict[str, Any]) -> tuple[Any, Any]:
    mi.set_variant("llvm_ad_rgb")
    return djpt.load_dict(description), mi.load_dict(description)


def share_of_equal(found: Any, wanted: Any, where: Any = True, rtol: float = 1e-4, atol: float = 1e-5) -> float:
    """Share of the lanes in `where` that agree; all that djpt finds must be finite, Mitsuba's NaNs don't count."""
    found, wanted = np.array(found, np.float64), np.array(wanted, np.float64)
    assert np.isfinite(found).all()
    found, wanted, where = np.broadcast_arrays(found, wanted, where)
    counts = where & np.isfinite(wanted)
    assert counts.mean() > 0.1
    return float((np.abs(found - wanted) <= atol + rtol * np.abs(wanted))[counts].mean())


def compare_values(description: dict[str, Any], mode: int, sides: Any = True) -> None:
    """Eval and pdf for random pairs of directions on the sphere."""
    bsdf, reference = load_both(description)
    wi, wo = directions(COUNT, 1), directions(COUNT, 2)
    value, pdf = bsdf.eval_pdf(BSDFContext(TransportMode(mode)), seen_from(wi), Vector3f(wo))
    context = mi.BSDFContext(mi.TransportMode(mode))
    true_value, true_pdf = reference.eval_pdf(context, mitsubas_point(wi), mi.Vector3f(wo))
    assert share_of_equal(value, true_value) >= 0.999
    assert share_of_equal(pdf, true_pdf, sides(wi) if callable(sides) else sides) >= 0.98
    assert np.array(value).max() > 0


def compare_samples(description: dict[str, Any], mode: int, smooth: bool = False) -> None:
    """The same random numbers, the same lobes, directions, densities and weights."""
    bsdf, reference = load_both(description)
    wi, (s1, x, y) = directions(COUNT, 3), uniform(COUNT, 3, seed=4)
    bs, weight = bsdf.sample(BSDFContext(TransportMode(mode)), seen_from(wi), s1, Point2f(x, y))
    context = mi.BSDFContext(mi.TransportMode(mode))
    true_bs, true_weight = reference.sample(context, mitsubas_point(wi), mi.Float(s1), mi.Point2f(x, y))
    lit = np.broadcast_to(np.array(weight), (3, COUNT)).max(axis=0) > 0
    assert np.mean(lit != (np.nan_to_num(np.array(true_weight)).max(axis=0) > 0)) <= 1e-3
    for name in ("sampled_type", "sampled_component"):
        assert share_of_equal(getattr(bs, name), getattr(true_bs, name), lit) >= 0.999
    assert share_of_equal(bs.eta, true_bs.eta, lit) >= 0.999
    assert share_of_equal(bs.wo, true_bs.wo, lit, atol=3e-4 if smooth else 2e-5) >= 0.999
    for one, other in ((bs.pdf, true_bs.pdf), (weight, true_weight)):
        assert share_of_equal(one, other, lit) >= (0.9 if smooth else 0.995)


CASES = [pytest.param(values, id=name) for name, values in {**OPAQUE, **CLEAR, **SMOOTH}.items()]
MODES = pytest.mark.parametrize("mode", [0, 1], ids=["radiance", "importance"])


def described(values: dict[str, Any]) -> dict[str, Any]:
    return {"type": "principled", "base_color": COLOR, **values}


@MODES
@pytest.mark.parametrize("values", CASES)
def test_values_are_mitsubas(values: dict[str, Any], mode: int) -> None:
    # Mitsuba's pdf of an opaque material isn't 0 from behind, where it never samples.
    clear = "spec_trans" in values
    compare_values(described(values), mode, sides=True if clear else lambda wi: wi[2] > 0)


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

WI = {"slanted": (0.6, -0.3, 0.5), "grazing": (0.9, 0.4, 0.05), "behind": (0.3, 0.5, -0.8)}


def follows_its_density(description: dict[str, Any], wi: Any, fine: int = 32) -> None:
    bsdf = djpt.load_dict(description)
    si, (s1, x, y) = seen_from(np.array(wi)[:, None] / np.linalg.norm(wi)), uniform(2**17, 3, seed=7)
    bs, weight = bsdf.sample(BSDFContext(), si, s1, Point2f(x, y))
    counts = (dr.max(weight) > 0) & (bs.pdf > 0)
    p, integral = p_value(SPHERE, bs.wo, counts, lambda wo: bsdf.pdf(BSDFContext(), si, wo), fine=fine)
    assert integral <= 1 + 5e-3
    assert p > SIGNIFICANCE


@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("values", [pytest.param(v, id=name) for name, v in {**OPAQUE, **CLEAR}.items()])
def test_samples_follow_the_density(values: dict[str, Any], wi: Any) -> None:
    follows_its_density(described(values), wi, fine=96 if "clearcoat" in values else 32)


# ---------------------------------------------------------------- gradients


def check_gradients(description: dict[str, Any], off: Any = (), step: float = 1e-3) -> None:
    """Of every value by each differentiable parameter: AD against differences, lane by lane.

    Where microfacets begin to face the other way the value jumps: a few lanes may lie there.
    """
    bsdf = djpt.load_dict(description)
    si, wo = seen_from(directions(COUNT, 5)), Vector3f(directions(COUNT, 6))

    def value() -> Any:
        # Green, of a colour that is neither black nor white there.
        return bsdf.eval(BSDFContext(), si, wo).y

    params = djpt.traverse(bsdf)
    for key in [key for key in params if params.flags(key) & djpt.ParamFlags.Differentiable]:
        if key.split(".")[0] in off:
            continue
        middle = type(params[key])(params[key])
        found_at = []
        for shifted in (middle - step, middle + step):
            params[key] = shifted
            params.update()
            found_at.append(np.array(value(), np.float64))
        params[key] = middle
        dr.enable_grad(params[key])
        params.update()
        dr.set_grad(params[key], 1)
        found = np.array(dr.forward_to(value()), np.float64)
        params[key] = dr.detach(middle)
        params.update()
        low, high = found_at
        wanted = (high - low) / (2 * step)
        assert np.abs(wanted).max() > 1e-3, key
        # Float32 knows a difference of two values to about their last digits.
        noise = 4e-7 * (np.abs(low) + np.abs(high)) / step + 1e-6
        assert np.mean(np.abs(found - wanted) <= noise + 2e-2 * np.abs(wanted)) >= 0.99, key


GRADIENT_CASES = {
    "everything": EVERYTHING,
    "thinner inside": {**EVERYTHING, **CLEAR["thinner inside"]},
    "opaque": {key: value for key, value in EVERYTHING.items() if key != "spec_trans"},
}
del GRADIENT_CASES["thinner inside"]["specular"]


@pytest.mark.parametrize("values", GRADIENT_CASES.values(), ids=GRADIENT_CASES)
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

CORNERS = np.array(
    [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 0, 1e-4), (-1, 0, 1e-4), (1, 0, -1e-4), (1, 0, 1e-20),
     (-1, 1e-9, -1e-38), (0.6, 0, 0.8), (-0.6, 0, 0.8), (-0.6, 0, -0.8), (0, 0, 0)],
    np.float32,
).T  # fmt: skip


def stays_finite(description: dict[str, Any]) -> None:
    """Values, densities, weights and gradients at the poles, on the horizon and between."""
    ends = np.concatenate([CORNERS, directions(24, 9)], axis=1)
    pairs = np.array(list(itertools.product(ends.T, ends.T))).transpose(1, 2, 0)
    si, wo = seen_from(pairs[0]), Vector3f(pairs[1])
    bsdf = djpt.load_dict(description)
    params = djpt.traverse(bsdf)
    keys = [key for key in params if params.flags(key) & djpt.ParamFlags.Differentiable]
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    edge = np.float32([0, 1e-7, 0.25, 0.5, 1 - 2**-24])
    s1, x, y = (Float(np.resize(c.ravel(), pairs.shape[2])) for c in np.meshgrid(edge, edge, edge))
    for mode in TransportMode:
        value, pdf, bs, weight = bsdf.eval_pdf_sample(BSDFContext(mode), si, wo, s1, Point2f(x, y))
        for found in (value, pdf, weight, bs.pdf, bs.wo, bs.eta):
            assert np.isfinite(np.array(dr.detach(found))).all()
        assert min(np.array(dr.detach(found)).min() for found in (value, pdf, weight, bs.pdf)) >= 0
        dr.backward(dr.sum(value + weight))
        for key in keys:
            assert np.isfinite(np.array(dr.grad(params[key]))).all(), key


ENDS: list[dict[str, Any]] = [
    dict(zip(EVERYTHING, numbers, strict=True))
    for numbers in (
        [0.0] * 11, [1.0] * 11, [0.0, 1.0] * 5 + [0.0], [1.0, 0.0] * 5 + [1.0],
        [0.5] * 10 + [0.0], [0.5] * 9 + [0.0, 1.0], [1.0, 0.0, 1.0, 1.0] + [1.0] * 6 + [0.0],
    )
]  # fmt: skip


@pytest.mark.parametrize("color", [0.0, 1.0, [1.0, 0.0, 0.0]])
@pytest.mark.parametrize("values", ENDS)
def test_nothing_is_undefined_at_the_ends(values: dict[str, Any], color: Any) -> None:
    # A texture of its own switches a lobe on although it is 0.
    on = {key: {"type": "uniform", "value": v} if key != "specular" else v for key, v in values.items()}
    base_color = {"type": "rgb", "value": color} if isinstance(color, list) else color
    stays_finite({"type": "principled", **on, "base_color": base_color})


@pytest.mark.parametrize("eta", [1e-3, 1.0, 20.0])
def test_nothing_is_undefined_for_odd_interfaces(eta: float) -> None:
    values = {key: value for key, value in EVERYTHING.items() if key != "specular"}
    stays_finite(described({**values, "eta": eta}))
    stays_finite(described({"eta": eta, "roughness": 0.0, "metallic": 0.5, "spec_tint": 1.0}))


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


def bsdf_value(bsdf: Any, si: Any, wo: Any) -> np.ndarray:
    return np.array(bsdf.eval(BSDFContext(), si, wo))


@pytest.mark.parametrize("values", [{}, {"anisotropic": 0.5}, {"clearcoat": 0.5}, {"spec_trans": 0.5}, EVERYTHING])
def test_flags_are_mitsubas(values: dict[str, Any]) -> None:
    bsdf, reference = load_both(described(values))
    assert bsdf.flags() == reference.flags()


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"eta": 1.5, "specular": 0.5}, "'eta' and 'specular' say the same thing"),
        ({"specular": 1.5}, r"'specular' must lie in \[0, 1\], found 1.5"),
        ({"eta": 0.0}, "'eta' must be greater than 0"),
        ({"roughness": -0.1}, r"'roughness' must lie in \[0, 1\]"),
        ({"metallic": 1.2}, r"'metallic' must lie in \[0, 1\]"),
        ({"clearcoat_sampling_rate": -1.0}, "'clearcoat_sampling_rate' must be at least 0"),
        ({"clearcoat_glass": 0.5}, "'clearcoat_glass'.*clearcoat_gloss"),
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
        ("specular", -0.1, "at least 0"),
        ("clearcoat.value", 2.0, r"lie in \[0, 1\]"),
        ("main_specular_sampling_rate", -1.0, "at least 0"),
    ],
)
def test_wrong_edits_are_explained(key: str, value: float, message: str) -> None:
    params = djpt.traverse(djpt.load_dict({"type": "principled"}))
    with pytest.raises(djpt.ParameterError, match=message):
        params[key] = value
