"""Derivatives by each parameter of each material: of its values, and of images of it, against finite differences.

Images tell little of parameters that make one place brighter and another darker: values are compared direction by
direction, where nothing averages out. Differences of two images with one seed are noisy: a parameter moves the samples
as well, and a choice that flips moves them far. Derivatives keep the samples where they are. Both have the same mean.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFContext, BSDFFlags, SurfaceInteraction3f, has_flag
from djpt.core.warp import square_to_uniform_sphere
from djpt.jit.types import Float, Point2f, UInt32, Vector3f
from djpt.materials.perturbed import WINDOW, PerturbedBSDF, direction
from djpt.validation.gradcheck.losses import quotient
from tests.kit.chi_squared import uniform
from tests.kit.derivatives import Slopes, differentiable, numbers
from tests.kit.materials import NAMES, ball, bsdf, cases, first_of_each, in_kernel, interaction

# ---------------------------------------------------------------- values, direction by direction


COUNT, ROWS, CHOICES = 4096, 32, 2**15


def like(parameter: Any, value: np.ndarray) -> Any:
    """Numbers as a parameter."""
    kind, value = type(parameter), np.asarray(value, np.float32)
    return kind(value) if value.ndim > 1 else kind(*np.atleast_1d(value).tolist())


class BSDFSlopes:
    """Derivatives by the parameters, one direction each: of `eval`, or of what delta lobes carry."""

    def __init__(self, name: str) -> None:
        self.bsdf = djpt.load_dict(bsdf(name))
        self.params = djpt.traverse(self.bsdf)
        self.keys = differentiable(self.params)
        rng = np.random.default_rng(3)
        # Off the ends of all ranges, so that there is room for a step on both sides; lobes that are off are on then.
        self.at = {key: 0.85 * numbers(self.params[key]) + 0.05 for key in self.keys}
        self.along = {
            key: rng.uniform(0.5, 1, value.shape) * np.maximum(1, np.abs(value)) for key, value in self.at.items()
        }
        self.put(self.at)
        self.si = surface()
        self.wo = self.directions()

    def directions(self) -> Vector3f:
        """Half of them random, half of them sampled, which finds narrow lobes."""
        x, y, s1, a, b = uniform(COUNT, 5, seed=2)
        bs, weight = in_kernel(self.bsdf).sample(BSDFContext(), self.si, s1, Point2f(x, y))
        sampled = (dr.max(weight) > 0) & (dr.arange(UInt32, COUNT) % 2 == 0)
        wo = dr.select(sampled, bs.wo, square_to_uniform_sphere(Point2f(a, b)))
        dr.eval(wo)
        return wo

    def put(self, values: dict[str, np.ndarray]) -> None:
        for key, value in values.items():
            self.params[key] = like(self.params[key], value)
        self.params.update()

    def value(self, delta: bool) -> Any:
        """The function that is differentiated."""
        material = in_kernel(self.bsdf)
        return delta_power(material) if delta else material.eval(BSDFContext(), self.si, self.wo)

    def derivative(self, key: str, delta: bool, alone: bool = False) -> np.ndarray:
        """By automatic differentiation, all parameters attached or one `alone`: all have one kernel between them."""
        attached = [key] if alone else self.keys
        for other in attached:
            dr.enable_grad(self.params[other])
            self.params.set_dirty(other)
        self.params.update()
        result = self.value(delta)
        for other in attached:
            tangent = like(self.params[other], self.along[other] * (other == key))
            dr.make_opaque(tangent)
            dr.set_grad(self.params[other], tangent)
        slope = dr.forward_to(result, flags=dr.ADFlag.ClearEdges | dr.ADFlag.AllowNoGrad)
        found = np.array(slope, np.float64)
        self.put({other: self.at[other] for other in attached})
        return found

    def difference(self, key: str, delta: bool, step: float) -> np.ndarray:
        """By a central difference."""

        def at(length: float) -> np.ndarray:
            self.put({key: self.at[key] + length * self.along[key]})
            return np.array(self.value(delta), np.float64)

        found = quotient(at, step)
        self.put({key: self.at[key]})
        return found


def surface() -> SurfaceInteraction3f:
    """Random points, seen from everywhere."""
    a, b, u, v = uniform(COUNT, 4, seed=1)
    si = interaction(square_to_uniform_sphere(Point2f(a, b)), width=COUNT)
    si.uv = Point2f(u, v)
    return si


def delta_power(material: Any) -> Any:
    """What delta lobes carry: the mean of their weights, for some directions."""
    a, b, u, v = (dr.repeat(x, CHOICES) for x in uniform(ROWS, 4, seed=4))
    si = interaction(square_to_uniform_sphere(Point2f(a, b)), width=ROWS * CHOICES)
    si.uv = Point2f(u, v)
    s1 = dr.tile((dr.arange(Float, CHOICES) + 0.5) / CHOICES, ROWS)
    bs, weight = material.sample(BSDFContext(), si, s1, Point2f(0.5))
    weight = dr.select((s1 >= 0) & has_flag(bs.sampled_type, BSDFFlags.Delta), weight, 0)  # one per lane
    return dr.block_sum(weight, CHOICES) / CHOICES


COARSE = "RoughPlastic"
"""Its coat is tabulated, and the tables' derivatives are differences over 10 % of alpha: good to 1 or 2 %."""
MAY_DIFFER: dict[str, float] = {COARSE: 0.06}
"""The share of points whose derivatives may differ."""


def near_jumps(slopes: BSDFSlopes) -> Any:
    """Where bent normals are about to turn away: derivatives there hold those of the jumps, which differences miss."""
    if not isinstance(slopes.bsdf, PerturbedBSDF):
        return False
    n = direction(slopes.bsdf.normal(slopes.si, True), Vector3f(0, 0, 1))
    return np.array(dr.abs(dr.dot(slopes.si.wi, n)) < WINDOW)


def close(slopes: BSDFSlopes, key: str, delta: bool, factor: float = 1.0, alone: bool = False) -> tuple[bool, str]:
    """Do nearly all derivatives agree? `factor` makes them wrong."""
    plain = np.array(slopes.value(delta), np.float64)
    if delta:
        # Means jump by this much where a choice changes.
        step = 2e-2
        noise: Any = 0.8 / CHOICES / step * np.ones_like(plain)
    else:
        step = 4e-3
        noise = 1e-6 / step * np.abs(plain) + 1e-7
    exact = factor * slopes.derivative(key, delta, alone)
    found, wider = (slopes.difference(key, delta, h) for h in (step, 2 * step))
    exact, found, wider, noise = np.broadcast_arrays(exact, found, wider, noise)
    # Neither curvature nor a jump spoils what has the same slope for both steps.
    clear = (np.abs(found - wider) <= 0.01 * np.abs(found) + 2 * noise) & ~np.asarray(near_jumps(slopes))
    coarse = type(slopes.bsdf).__name__ == COARSE
    wrong = np.abs(exact - found) > (0.03 if coarse else 0.02) * np.abs(found) + 2 * noise
    telling = clear & (np.abs(found) > 100 * noise)
    shares = [np.mean(wrong[part]) if part.any() else 0.0 for part in (clear, telling)]
    text = f"{key}: {telling.sum()} telling, {shares[1]:.4f} wrong; {shares[0]:.4f} of all; {clear.mean():.3f} clear"
    few = max(shares) < MAY_DIFFER.get(type(slopes.bsdf).__name__, 0.02)
    return bool(np.isfinite(exact).all() and few and clear.mean() > 0.5), text


def lobes(bsdf: Any) -> list[bool]:
    """Which functions the BSDF has: smooth ones (False), deltas (True)."""
    return [
        delta for delta, flag in ((False, BSDFFlags.Smooth), (True, BSDFFlags.Delta)) if has_flag(bsdf.flags(), flag)
    ]


@pytest.mark.sparse(54)
@pytest.mark.parametrize("name", cases())
def test_every_parameter_of_a_bsdf(name: str) -> None:
    slopes = BSDFSlopes(name)
    verdicts = [close(slopes, key, delta) for key in slopes.keys for delta in lobes(slopes.bsdf)]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@pytest.mark.sparse(18)
@pytest.mark.parametrize("factor", [1.05, -1.0])
@pytest.mark.parametrize(
    ("name", "key", "delta"),
    [
        ("diffuse-bitmap", "reflectance.data", False),
        ("roughconductor-brushed", "alpha_u.value", False),
        ("roughdielectric-polished", "eta", False),
        ("roughplastic-ggx", "alpha", False),
        ("principled-everything", "anisotropic.value", False),
        ("principled-coated", "clearcoat_gloss.value", False),
        ("phong-glossy", "exponent.value", False),
        ("normalmap-gold", "normalmap.data", False),
        ("mask-metal", "opacity.data", True),
        ("thindielectric-tinted", "eta", True),
        ("plastic-colour", "eta", True),
    ],
)
def test_wrong_derivatives_of_a_bsdf_fail(name: str, key: str, delta: bool, factor: float) -> None:
    """The test's power; and parameters that are attached alone."""
    slopes = BSDFSlopes(name)
    assert close(slopes, key, delta, alone=True)[0]
    assert not close(slopes, key, delta, factor, alone=True)[0]


# ---------------------------------------------------------------- images of a ball


JUMPS = {"roughdielectric-ggx": {"ball.bsdf.eta"}, "roughdielectric-bubble": {"ball.bsdf.eta"}}
"""GGX has facets at right angles to the surface: refraction by them ends abruptly at directions that move with the
index, which differentiating at a fixed direction can't see. The parameter is flagged `Discontinuous`."""


class ImageSlopes(Slopes):
    """By the parameters of a material on a ball."""

    size, spp, seeds = 24, 256, (8, 40)

    def __init__(self, name: str, schedule: str = "auto") -> None:
        description = ball(bsdf(name), self.size, "prb")
        # Roulette follows the brightest channel: differences then see it only where a decision flips, which is rare.
        description["integrator"]["rr_depth"] = 1000
        scene = djpt.load_dict(description)
        params, rng = djpt.traverse(scene), np.random.default_rng(3)
        # Off the ends of all ranges, so that there is room for a step on both sides.
        at = {
            key: 0.9 * numbers(params[key]) + 0.03 for key in differentiable(params, "ball.bsdf", JUMPS.get(name, ()))
        }
        self.coarse = any(type(shape.bsdf()).__name__ == COARSE for shape in scene.shapes())
        super().__init__(scene, at, {key: rng.uniform(0.5, 1, value.shape) for key, value in at.items()}, schedule)

    def check(self, key: str, exact: dict[int, dict[str, float]], factor: float = 1.0) -> tuple[bool, str]:
        self.slack = 0.03 if self.coarse and key.endswith(".eta") else Slopes.slack
        return super().check(key, exact, factor)


# Dozens of images each, more than ten seconds: values are differentiated above, images in files of theirs.
LONG = ("blendbsdf", "hair", "principled", "principledthin", "roughplastic")


@pytest.mark.sparse(24)
@pytest.mark.parametrize("name", first_of_each(NAMES, LONG))
@pytest.mark.slow
def test_every_parameter_in_an_image(name: str) -> None:
    slopes, exact = ImageSlopes(name), {}
    verdicts = [slopes.check(key, exact) for key in slopes.keys]
    print(name, *(text for _, text in verdicts), sep="\n  ")
    assert all(good for good, _ in verdicts), "\n".join(text for good, text in verdicts if not good)


@pytest.mark.sparse(144)
@pytest.mark.parametrize("name", first_of_each(NAMES))
def test_schedules_agree(name: str) -> None:
    """The same samples in another order."""
    pair = [ImageSlopes(name, schedule) for schedule in ("flat", "wave")]
    if not pair[0].keys:
        pytest.skip("no parameter has a gradient")
    flat, wave = (slopes.slopes(1) for slopes in pair)
    largest = max(map(abs, flat.values()))
    for key, slope in flat.items():
        assert wave[key] == pytest.approx(slope, rel=1e-3, abs=1e-4 * largest), key


@pytest.mark.sparse(2)
@pytest.mark.parametrize(
    ("name", "key", "factor"),
    [
        ("diffuse-colour", "ball.bsdf.reflectance.value", 1.05),
        ("mask-diffuse", "ball.bsdf.opacity.value", -1.0),
        pytest.param("roughconductor-gold", "ball.bsdf.alpha.value", -1.0, marks=pytest.mark.slow),
        pytest.param("plastic-colour", "ball.bsdf.diffuse_reflectance.value", 1.05, marks=pytest.mark.slow),
        pytest.param("diffuse-bitmap", "ball.bsdf.reflectance.data", 1.05, marks=pytest.mark.slow),
        pytest.param("principledthin-everything", "ball.bsdf.sheen_tint.value", 1.05, marks=pytest.mark.slow),
    ],
)
def test_wrong_derivatives_of_an_image_fail(name: str, key: str, factor: float) -> None:
    """The test's power, of fewer images than it may judge by."""
    slopes = ImageSlopes(name)
    slopes.seeds = (8, 12)
    assert not slopes.check(key, {}, factor)[0]
