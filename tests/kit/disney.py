"""Checks of both of Disney's materials: against Mitsuba, their own densities, and finite differences."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, SurfaceInteraction3f, TransportMode
from djpt.jit.types import Float, Point2f, Point3f, Vector3f
from djpt.validation.gradcheck.losses import quotient
from tests.kit.arrays import floats, in_numpy, rows
from tests.kit.chi_squared import SIGNIFICANCE, SPHERE, p_value, uniform

__all__ = [
    "COLOR",
    "MODES",
    "WI",
    "bsdf_value",
    "check_gradients",
    "compare_samples",
    "compare_values",
    "directions",
    "follows_its_density",
    "load_both",
    "seen_from",
    "stays_finite",
]

mi = pytest.importorskip("mitsuba")


COUNT = 8192
COLOR = {"type": "rgb", "value": [0.8, 0.3, 0.1]}


def directions(count: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(3, count))
    return (v / np.linalg.norm(v, axis=0)).astype(np.float32)


def seen_from(wi: Any) -> SurfaceInteraction3f:
    """A surface point in its own frame; `wi` are the columns of (3, n)."""
    z, wi = Vector3f(0, 0, 1), Vector3f(*rows(wi))
    return SurfaceInteraction3f(
        t=dr.full(Float, 1, dr.width(wi)),
        p=Point3f(0),
        n=z,
        sh_frame=Frame3f(Vector3f(1, 0, 0), Vector3f(0, 1, 0), z),
        uv=Point2f(0.3, 0.6),
        dp_du=Vector3f(1, 0, 0),
        dp_dv=Vector3f(0, 1, 0),
        wi=wi,
    )


def mitsubas_point(wi: np.ndarray) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, wi.shape[1])
    si.wi, si.uv = mi.Vector3f(*rows(wi)), mi.Point2f(0.3, 0.6)
    return si


def load_both(description: dict[str, Any]) -> tuple[Any, Any]:
    mi.set_variant("llvm_ad_rgb")
    return djpt.load_dict(description), mi.load_dict(description)


def share_of_equal(found: Any, wanted: Any, where: Any = True, rtol: float = 1e-4, atol: float = 1e-5) -> float:
    """The share of the lanes in `where` that agree; djpt's numbers must be finite, Mitsuba's NaNs don't count."""
    found, wanted = in_numpy(found), in_numpy(wanted)
    assert np.isfinite(found).all()
    found, wanted, where = np.broadcast_arrays(found, wanted, where)
    counts = where & np.isfinite(wanted)
    assert counts.mean() > 0.1
    return float((np.abs(found - wanted) <= atol + rtol * np.abs(wanted))[counts].mean())


def compare_values(description: dict[str, Any], mode: int, sides: Any = True) -> None:
    """Compare values and densities with Mitsuba's, for random pairs of directions on the sphere."""
    bsdf, reference = load_both(description)
    wi, wo = directions(COUNT, 1), directions(COUNT, 2)
    value, pdf = bsdf.eval_pdf(BSDFContext(TransportMode(mode)), seen_from(wi), Vector3f(*rows(wo)))
    context = mi.BSDFContext(mi.TransportMode(mode))
    true_value, true_pdf = reference.eval_pdf(context, mitsubas_point(wi), mi.Vector3f(*rows(wo)))
    dr.eval(value, pdf)
    dr.eval(true_value, true_pdf)
    assert share_of_equal(value, true_value) >= 0.999
    assert share_of_equal(pdf, true_pdf, sides(wi) if callable(sides) else sides) >= 0.98
    assert in_numpy(value).max() > 0


def compare_samples(description: dict[str, Any], mode: int, smooth: bool = False) -> None:
    """Compare samples with Mitsuba's: equal random numbers give equal lobes, directions, densities and weights."""
    bsdf, reference = load_both(description)
    wi, (s1, x, y) = directions(COUNT, 3), uniform(COUNT, 3, seed=4)
    bs, weight = bsdf.sample(BSDFContext(TransportMode(mode)), seen_from(wi), s1, Point2f(x, y))
    context = mi.BSDFContext(mi.TransportMode(mode))
    true_bs, true_weight = reference.sample(context, mitsubas_point(wi), mi.Float(s1), mi.Point2f(x, y))
    dr.eval(bs, weight)
    dr.eval(true_bs, true_weight)
    lit = np.broadcast_to(in_numpy(weight), (3, COUNT)).max(axis=0) > 0
    assert np.mean(lit != (np.nan_to_num(in_numpy(true_weight)).max(axis=0) > 0)) <= 1e-3
    for name in ("sampled_type", "sampled_component"):
        assert share_of_equal(getattr(bs, name), getattr(true_bs, name), lit) >= 0.999
    assert share_of_equal(bs.eta, true_bs.eta, lit) >= 0.999
    assert share_of_equal(bs.wo, true_bs.wo, lit, atol=3e-4 if smooth else 2e-5) >= 0.999
    for one, other in ((bs.pdf, true_bs.pdf), (weight, true_weight)):
        assert share_of_equal(one, other, lit) >= (0.9 if smooth else 0.995)


MODES = pytest.mark.parametrize("mode", [0, 1], ids=["radiance", "importance"])
WI = {"slanted": (0.6, -0.3, 0.5), "grazing": (0.9, 0.4, 0.05), "behind": (0.3, 0.5, -0.8)}


def follows_its_density(description: dict[str, Any], wi: Any, fine: int = 32) -> None:
    bsdf = djpt.load_dict(description)
    si, (s1, x, y) = seen_from(np.array(wi)[:, None] / np.linalg.norm(wi)), uniform(2**17, 3, seed=7)
    bs, weight = bsdf.sample(BSDFContext(), si, s1, Point2f(x, y))
    counts = (dr.max(weight) > 0) & (bs.pdf > 0)
    p, integral = p_value(SPHERE, bs.wo, counts, lambda wo: bsdf.pdf(BSDFContext(), si, wo), fine=fine)
    assert integral <= 1 + 5e-3
    assert p > SIGNIFICANCE


def check_gradients(description: dict[str, Any], off: Any = (), step: float = 1e-3) -> None:
    """Compare AD with differences, lane by lane, for every value and each differentiable parameter.

    Where microfacets begin to face the other way the value jumps: a few lanes may lie there.
    """
    bsdf = djpt.load_dict(description)
    si, wo = seen_from(directions(COUNT, 5)), Vector3f(directions(COUNT, 6))

    def value() -> Any:
        # Green, of a colour that is neither black nor white there.
        return bsdf.eval(BSDFContext(), si, wo).y

    params = djpt.traverse(bsdf)
    for key in [key for key in params if params.flags(key).differentiable]:
        if key.split(".")[0] in off:
            continue
        middle = type(params[key])(params[key])
        size = 0.0

        def at(x: float, key: str = key, middle: Any = middle) -> np.ndarray:
            nonlocal size
            params[key] = middle + x
            params.update()
            result = np.array(value(), np.float64)
            size = size + np.abs(result)
            return result

        wanted = quotient(at, step)
        params[key] = middle
        dr.enable_grad(params[key])
        params.update()
        dr.set_grad(params[key], 1)
        found = np.array(dr.forward_to(value()), np.float64)
        params[key] = dr.detach(middle)
        params.update()
        assert np.abs(wanted).max() > 1e-3, key
        # Float32 knows a difference of two values to about their last digits.
        noise = 4e-7 * size / step + 1e-6
        assert np.mean(np.abs(found - wanted) <= noise + 2e-2 * np.abs(wanted)) >= 0.99, key


CORNERS = np.array(
    [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 0, 1e-4), (-1, 0, 1e-4), (1, 0, -1e-4), (1, 0, 1e-20),
     (-1, 1e-9, -1e-38), (0.6, 0, 0.8), (-0.6, 0, 0.8), (-0.6, 0, -0.8), (0, 0, 0)],
    np.float32,
).T  # fmt: skip


def stays_finite(description: dict[str, Any]) -> None:
    """Check values, densities, weights and gradients at the poles, on the horizon and between."""
    ends = np.concatenate([CORNERS, directions(24, 9)], axis=1)
    pairs = np.array(list(itertools.product(ends.T, ends.T))).transpose(1, 2, 0)
    si, wo = seen_from(pairs[0]), Vector3f(*rows(pairs[1]))
    bsdf = djpt.load_dict(description)
    params = djpt.traverse(bsdf)
    keys = [key for key in params if params.flags(key).differentiable]
    for key in keys:
        dr.enable_grad(params[key])
    params.update()
    edge = np.float32([0, 1e-7, 0.25, 0.5, 1 - 2**-24])
    s1, x, y = (floats(np.resize(c.ravel(), pairs.shape[2])) for c in np.meshgrid(edge, edge, edge))
    for mode in TransportMode:
        value, pdf, bs, weight = bsdf.eval_pdf_sample(BSDFContext(mode), si, wo, s1, Point2f(x, y))
        dr.backward(dr.sum(value + weight))
        dr.eval(value, pdf, bs, weight, [dr.grad(params[key]) for key in keys])
        for found in (value, pdf, weight, bs.pdf, bs.wo, bs.eta):
            assert np.isfinite(in_numpy(dr.detach(found))).all()
        assert min(in_numpy(dr.detach(found)).min() for found in (value, pdf, weight, bs.pdf)) >= 0
        for key in keys:
            assert np.isfinite(np.array(dr.grad(params[key]))).all(), key


def bsdf_value(bsdf: Any, si: Any, wo: Any) -> np.ndarray:
    return np.array(bsdf.eval(BSDFContext(), si, wo))
