"""Every BSDF, with every set of parameters of tests/kit/materials.py, by what it claims of itself.

A new plugin is tested as soon as it is registered; give it parameters in tests/kit/materials.py.
"""

from __future__ import annotations

import functools
from typing import Any

import drjit as dr
import numpy as np
import pytest

from djpt.core.records import BSDFContext, BSDFFlags, TransportMode, has_flag
from djpt.core.warp import square_to_uniform_sphere
from djpt.jit.types import Float, Point2f, UInt32, Vector3f
from djpt.validation.statistics import sidak
from tests.kit.arrays import floats, in_numpy
from tests.kit.chi_squared import Partition, probability_of_counts, uniform
from tests.kit.materials import NAMES, PLUGINS, SETS, bsdf, cases, in_kernel, interaction, opaque_wi, plugin_of

COUNT = 2**16
WI = {
    "straight": (0, 0, 1),
    "slanted": (0.6, -0.3, 0.5),
    "low": (-0.7, 0.6, 0.25),
    "grazing": (0.9, 0.4, 0.02),
    "behind": (0.3, 0.5, -0.8),
}
LEVEL = sidak(0.01, len(NAMES) * len(WI))
"""Of each chi-squared test: all together alarm falsely in one of a hundred changes of the random numbers."""

RADIANCE, IMPORTANCE = BSDFContext(), BSDFContext(TransportMode.Importance)


@functools.cache
def loaded(name: str) -> Any:
    return in_kernel(bsdf(name))


def wide(x: Any, width: int) -> np.ndarray:
    """Lanes of an array, (width,) or (components, width)."""
    array = in_numpy(x)
    return np.broadcast_to(array, (*array.shape[:-1], width))


def smooth(material: Any) -> bool:
    """Has it a lobe that isn't a delta? Densities are about those alone."""
    return bool(has_flag(material.flags(), BSDFFlags.Smooth))


def drawn(material: Any, wi: Any, count: int, seed: int = 2, ctx: BSDFContext = RADIANCE) -> tuple[Any, Any, Any]:
    """(samples, weights, which ones are smooth and not lost)."""
    s1, x, y = uniform(count, 3, seed=seed)
    bs, weight = material.sample(ctx, interaction(opaque_wi(wi)), s1, Point2f(x, y))
    counts = (dr.max(weight) > 0) & (bs.pdf > 0) & has_flag(bs.sampled_type, BSDFFlags.Smooth)
    dr.eval(bs, weight, counts)
    return bs, wide(weight, count), np.broadcast_to(np.array(counts), (count,))


def test_every_bsdf_has_parameter_sets() -> None:
    assert set(SETS) == set(PLUGINS), "add the plugin to SETS in tests/kit/materials.py"


# ---------------------------------------------------------------- densities


def error(name: str) -> float:
    """The relative error of a density: Beckmann's shadowing is a fit by a rational function, good to 0.35 %."""

    def has_fit(node: Any) -> bool:
        if not isinstance(node, dict):
            return False
        rough = node["type"] in ("roughconductor", "roughdielectric", "roughplastic", "pplastic")
        fit = rough and node.get("distribution", "beckmann") == "beckmann" and node.get("sample_visible", True)
        return fit or any(has_fit(child) for child in node.values())

    return 1e-2 if has_fit(bsdf(name)) else 1e-3


def check_density(name: str, wi: Any, count: int) -> None:
    """Samples are as frequent as the density says, and weights average to the integral of `eval`."""
    material = loaded(name)
    if not smooth(material):
        pytest.skip("delta lobes have no density")
    si = interaction(opaque_wi(wi))
    partition = Partition(drawn(material, wi, 2**14, seed=1)[0].wo)
    bs, weight, counts = drawn(material, wi, count)

    def functions(wo: Any) -> np.ndarray:
        value, pdf = material.eval_pdf(RADIANCE, si, wo)
        dr.eval(value, pdf)
        width = dr.width(wo)
        return np.concatenate([wide(pdf, width)[None], wide(value, width)])

    integrals = partition.integrate(functions)
    assert integrals[0].sum() <= 1 + error(name)
    observed = partition.count(bs.wo, counts)
    lost, off = int(count - counts.sum()), error(name)
    assert probability_of_counts(observed, integrals[0], lost, off, off / 10) > LEVEL
    visible = np.where(counts, weight, 0)
    noise = 5 * visible.std(axis=1) / np.sqrt(count)
    difference = np.abs(visible.mean(axis=1) - integrals[1:].sum(axis=1))
    np.testing.assert_array_less(difference, noise + 0.3 * error(name) + 1e-4)


@pytest.mark.sparse(9)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("name", cases())
def test_samples_follow_the_density(name: str, wi: Any) -> None:
    check_density(name, wi, COUNT)


@pytest.mark.slow
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("name", cases())
def test_a_million_samples_follow_the_density(name: str, wi: Any) -> None:
    check_density(name, wi, 10**6)


def test_a_wrong_density_is_noticed() -> None:
    """The power of the test: 3 % of roughness."""
    material, wrong = (in_kernel({"type": "roughconductor", "alpha": alpha}) for alpha in (0.1, 0.103))
    wi = WI["slanted"]
    bs, _, counts = drawn(material, wi, COUNT)
    partition = Partition(drawn(material, wi, 2**14, seed=1)[0].wo)
    for other, fits in ((material, True), (wrong, False)):

        def density(wo: Any, other: Any = other) -> np.ndarray:
            return wide(other.pdf(RADIANCE, interaction(opaque_wi(wi)), wo), dr.width(wo))[None]

        expected = partition.integrate(density)[0]
        lost = int(COUNT - counts.sum())
        p = probability_of_counts(partition.count(bs.wo, counts), expected, lost, lost_error=1e-4)
        assert (p > LEVEL) == fits


DETACHED = {"principled", "principledthin"}
"""Their `sample` cuts derivatives itself: the statistical test has to do."""

MIXTURES = {"phong", "blinn", "roughplastic", "pplastic", "blendbsdf"}
"""Several lobes may lead to one direction: the density is the sum of all."""


@pytest.mark.sparse(9)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("name", cases())
def test_density_is_the_inverse_jacobian(name: str, wi: Any) -> None:
    """1 / density = the solid angle that a unit of the square is stretched to, by forward differentiation.

    For each sample, the probability of its lobe is counted out over `sample1`.
    """
    material = loaded(name)
    if not smooth(material):
        pytest.skip("delta lobes have no density")
    if plugin_of(name) in DETACHED:
        pytest.skip("samples have no derivatives")
    count, choices = 512, 256
    si = interaction(opaque_wi(wi))
    s1, x, y = uniform(count, 3, seed=3)
    bs, _, counts = drawn(material, wi, count, seed=3)
    # The derivatives by both numbers at once: the first half of the lanes has those by `x`.
    first = dr.arange(UInt32, 2 * count) < count
    sample = Point2f(*(dr.tile(Float(u), 2) for u in (x, y)))
    dr.enable_grad(sample)
    dr.set_grad(sample, Point2f(dr.select(first, Float(1), 0), dr.select(first, Float(0), 1)))
    wo = material.sample(RADIANCE, si, dr.tile(Float(s1), 2), sample)[0].wo
    columns = wide(dr.forward_to(wo), 2 * count).T.reshape(2, count, 3)
    stretch = np.linalg.norm(np.cross(*columns), axis=1)

    at = [dr.repeat(u, choices) for u in (x, y)]
    other = dr.tile((dr.arange(Float, choices) + 0.5) / choices, count)
    again, weight = material.sample(RADIANCE, si, other, Point2f(*at))
    dr.eval(again.wo, weight)
    apart = np.abs(wide(again.wo, count * choices).reshape(3, count, choices) - wide(bs.wo, count)[..., None]).max(
        axis=0
    )
    alive = wide(dr.max(weight), count * choices).reshape(count, choices) > 0
    probability = ((apart < 1e-4) & alive).mean(axis=1)

    # Where the map is nearly singular float32 has no digits left.
    fine = counts & (stretch > 1e-7) & (probability > 0.05)
    if not fine.any():
        pytest.skip("nothing is sampled on this side")
    ratio = (probability / np.where(fine, stretch, 1) / np.where(fine, wide(bs.pdf, count), 1))[fine]
    error = 1.5 / choices / probability[fine] + 1e-3
    assert np.mean(ratio > 1 + error) < 0.02
    if plugin_of(name) not in MIXTURES:
        assert np.mean(ratio < 1 - error) < 0.02


@pytest.mark.sparse(9)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("name", cases())
def test_weights_are_values_over_densities(name: str, wi: Any) -> None:
    material, count = loaded(name), 4096
    bs, weight, counts = drawn(material, wi, count)
    value, pdf = material.eval_pdf(RADIANCE, interaction(opaque_wi(wi)), bs.wo)
    dr.eval(value, pdf)
    value, pdf = wide(value, count), wide(pdf, count)
    claimed, kind = wide(bs.pdf, count), np.broadcast_to(np.array(bs.sampled_type), (count,))
    np.testing.assert_allclose(np.linalg.norm(wide(bs.wo, count)[:, weight.max(axis=0) > 0], axis=0), 1, atol=1e-5)
    # Lost samples claim no density that `pdf` doesn't know: mixtures would count on it.
    any_smooth = (kind & int(BSDFFlags.Smooth) != 0) & (claimed > 0)
    # At grazing angles rounding is amplified.
    right = np.isclose(pdf, claimed, rtol=1e-3)
    assert np.sum(any_smooth & ~right) <= 0.01 * np.sum(any_smooth)
    right = np.isclose(value, weight * claimed, rtol=2e-3).all(axis=0)
    assert np.sum(counts & ~right) <= 0.01 * counts.sum()


# ---------------------------------------------------------------- energy and reciprocity


BRIGHTER = {"principled-coated": 1.1, "principled-sheen": 1.04, "principled-subsurface": 1.7}
"""What reflects more than it receives, at low angles: coat and sheen are just added to what lies below. Light enters
bodies with `subsurface` as if its weight were 1, which is a factor of the way out.
"""


@pytest.mark.sparse(9)
@pytest.mark.parametrize("wi", WI.values(), ids=WI)
@pytest.mark.parametrize("name", cases())
def test_energy(name: str, wi: Any) -> None:
    """No more power leaves than arrives. (Radiance is denser behind a denser medium: importance isn't.)"""
    weight = drawn(loaded(name), wi, COUNT, ctx=IMPORTANCE)[1]
    assert np.isfinite(weight).all()
    assert weight.min() >= 0
    limit = BRIGHTER.get(name, 1.0)
    assert (weight.mean(axis=1) <= limit + 4 * weight.std(axis=1) / np.sqrt(COUNT) + 1e-3).all()


NOT_RECIPROCAL: dict[str, str] = {
    "bumpmap-diffuse": "tilted normals",
    "bumpmap-gold": "tilted normals",
    "normalmap-diffuse": "tilted normals",
    "normalmap-gold": "tilted normals",
    **{f"hair-{name}": "cosines of the fibre's own angles" for name in ("brown", "smooth", "rough", "clear", "dyed")},
    **{f"measured-{name}": "errors of measurement" for name in ("metal", "made up", "half a turn", "a quarter")},
    "principledthin-everything": "a condition of the specular transmission, as in Mitsuba",
    "principledthin-pane": "a condition of the specular transmission, as in Mitsuba",
}


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", cases())
def test_reciprocity(name: str) -> None:
    """f(wi, wo) of radiance is f(wo, wi) of importance: the way back is as bright, on both sides of the surface."""
    material, count = loaded(name), 4096
    if not smooth(material):
        pytest.skip("delta lobes are never evaluated")
    a, b, c, d = uniform(count, 4, seed=5)
    wi, wo = square_to_uniform_sphere(Point2f(a, b)), square_to_uniform_sphere(Point2f(c, d))
    there = material.eval(RADIANCE, interaction(wi), wo) / dr.abs(wo.z)
    back = material.eval(IMPORTANCE, interaction(wo), wi) / dr.abs(wi.z)
    dr.eval(there, back)
    there, back = wide(there, count), wide(back, count)
    equal = np.isclose(there, back, rtol=2e-3, atol=1e-5).all(axis=0)
    reason = NOT_RECIPROCAL.get(name)
    if reason is not None:
        assert equal.mean() < 0.99, f"is reciprocal, in spite of {reason}: remove it from NOT_RECIPROCAL"
    else:
        assert equal.mean() > 0.995


# ---------------------------------------------------------------- one call and several


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", cases())
def test_combined_calls_agree(name: str) -> None:
    material, count = loaded(name), 1024
    s1, x, y, a, b, c, d = uniform(count, 7, seed=6)
    si = interaction(square_to_uniform_sphere(Point2f(c, d)))
    wo = square_to_uniform_sphere(Point2f(a, b))
    value, pdf, bs, weight = material.eval_pdf_sample(RADIANCE, si, wo, s1, Point2f(x, y))
    alone, alone_weight = material.sample(RADIANCE, si, s1, Point2f(x, y))
    alone_value, alone_pdf = material.eval(RADIANCE, si, wo), material.pdf(RADIANCE, si, wo)
    both = material.eval_pdf(RADIANCE, si, wo)
    dr.eval(value, pdf, bs, weight, alone, alone_weight, alone_value, alone_pdf, both)
    everywhere, sampled = np.full(count, True), wide(dr.max(alone_weight), count) > 0
    for one, other, where in [
        (value, alone_value, everywhere),
        (pdf, alone_pdf, everywhere),
        (both[0], value, everywhere),
        (both[1], pdf, everywhere),
        (weight, alone_weight, everywhere),
        *((getattr(bs, key), getattr(alone, key), sampled) for key in ("wo", "pdf", "eta", "sampled_type")),
    ]:
        one, other = wide(one, count), wide(other, count)
        np.testing.assert_allclose(one[..., where], other[..., where], rtol=1e-4, atol=1e-6)


# ---------------------------------------------------------------- special directions

SHARP = {
    "roughconductor-sharp": {"type": "roughconductor", "alpha": 1e-4},
    "roughconductor-sharp ggx": {"type": "roughconductor", "alpha": 1e-4, "distribution": "ggx"},
    "roughconductor-sharp all": {"type": "roughconductor", "alpha": 1e-4, "sample_visible": False},
    "roughconductor-blade": {"type": "roughconductor", "alpha_u": 1e-4, "alpha_v": 1.0, "distribution": "ggx"},
    "roughconductor-1": {"type": "roughconductor", "alpha": 1.0},
    "roughdielectric-sharp": {"type": "roughdielectric", "alpha": 1e-4},
    "roughdielectric-sharp ggx": {"type": "roughdielectric", "alpha": 1e-4, "distribution": "ggx"},
    "roughdielectric-1": {"type": "roughdielectric", "alpha": 1.0, "distribution": "ggx"},
    "roughdielectric-all": {"type": "roughdielectric", "alpha": 1.0, "sample_visible": False},
    "roughplastic-sharp": {"type": "roughplastic", "alpha": 1e-4},
    "roughplastic-1": {"type": "roughplastic", "alpha": 1.0, "distribution": "ggx", "nonlinear": True},
    "principled-sharp": {"type": "principled", "roughness": 0.0, "anisotropic": 1.0, "metallic": 0.5},
    "principled-glass": {"type": "principled", "roughness": 0.0, "spec_trans": 1.0},
    "principled-coat": {"type": "principled", "clearcoat": 1.0, "clearcoat_gloss": 1.0, "base_color": 0.0},
    "principledthin-sharp": {"type": "principledthin", "roughness": 0.0, "spec_trans": 0.5, "diff_trans": 2.0},
    "phong-sharp": {"type": "phong", "exponent": 1e5},
    "blinn-sharp": {"type": "blinn", "exponent": 1e5},
}
SPECIAL = [
    (0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 0, 1e-8), (1, 0, -1e-8), (0.6, 0.8, 1e-4), (0.6, 0.8, -1e-4),
    (1e-5, 0, 1), (0, 1e-8, -1), (0.6, -0.3, 0.5), (-0.6, 0.3, 0.5), (0.6, -0.3, -0.5), (-0.6, 0.3, -0.5),
]  # fmt: skip
"""The poles, the horizon, and mirror images of one another."""

EDGES = [0.0, 2.0**-32, 0.25, 0.5, 1 - 2.0**-24]


@pytest.mark.sparse(4)
@pytest.mark.parametrize("ctx", [RADIANCE, IMPORTANCE], ids=["radiance", "importance"])
@pytest.mark.parametrize("name", cases([*NAMES, *SHARP]))
def test_special_directions_give_numbers(name: str, ctx: BSDFContext) -> None:
    material = in_kernel(SHARP[name]) if name in SHARP else loaded(name)
    v = np.array(SPECIAL, np.float64)
    v = (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)
    n, m = len(v), len(EDGES)
    lanes = np.indices((n, n, m, m, m)).reshape(5, -1)
    wi, wo = (Vector3f(*(floats(v[lanes[k], i]) for i in range(3))) for k in (0, 1))
    s1, x, y = (floats(np.array(EDGES)[lanes[k]]) for k in (2, 3, 4))
    value, pdf, bs, weight = material.eval_pdf_sample(ctx, interaction(wi), wo, s1, Point2f(x, y))
    again = material.eval_pdf(ctx, interaction(wi), bs.wo)
    dr.eval(value, pdf, bs, weight, again)
    for what in (value, pdf, weight, bs.pdf, bs.wo, *again):
        found = in_numpy(what)
        assert np.isfinite(found).all()
        assert what is bs.wo or found.min() >= 0


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", cases())
def test_albedo_is_not_negative(name: str) -> None:
    for wi in WI.values():
        albedo = np.array(loaded(name).eval_diffuse_reflectance(interaction(opaque_wi(wi))))
        assert np.isfinite(albedo).all()
        assert albedo.min() >= 0
