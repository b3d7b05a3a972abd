"""Microfacet distributions: what they promise of themselves, and Mitsuba's numbers."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.warp import square_to_uniform_sphere
from djpt.jit.types import Float, Point2f, Vector3f
from djpt.materials.microfacet import MicrofacetDistribution
from djpt.validation.gradcheck.losses import quotient

mi = pytest.importorskip("mitsuba")

COUNT = 8192
KINDS = ("beckmann", "ggx")
ALPHAS = [(0.1, 0.1), (0.5, 0.5), (1.0, 1.0), (0.02, 0.3), (1.0, 0.6), (0.0, 0.0)]


@pytest.fixture(autouse=True, scope="module")
def variant() -> None:
    mi.set_variant("llvm_ad_rgb")


def ours(kind: str, alpha: tuple[float, float], visible: bool = True) -> MicrofacetDistribution:
    u = Float(alpha[0])
    return MicrofacetDistribution(kind, u, u if alpha[0] == alpha[1] else Float(alpha[1]), visible)


def theirs(kind: str, alpha: tuple[float, float], visible: bool = True) -> Any:
    name = {"beckmann": mi.MicrofacetType.Beckmann, "ggx": mi.MicrofacetType.GGX}[kind]
    # Equal arrays, not equal numbers, make Mitsuba's isotropic.
    return mi.MicrofacetDistribution(name, *(alpha[:1] if alpha[0] == alpha[1] else alpha), visible)


def numbers(columns: int, seed: int) -> Any:
    return np.random.default_rng(seed).random((columns, COUNT), dtype=np.float32)


def sphere(seed: int) -> Any:
    """Directions over the whole sphere, some of them grazing; (3, COUNT)."""
    v = np.array(square_to_uniform_sphere(Point2f(numbers(2, seed))))
    v[2, : COUNT // 8] *= 1e-2
    return v / np.linalg.norm(v, axis=0)


def hemisphere(seed: int) -> Any:
    v = sphere(seed)
    v[2] = np.abs(v[2])
    return v


def share_beyond(found: Any, expected: Any, rtol: float, atol: float) -> float:
    found, expected = np.array(found), np.array(expected)
    assert np.isfinite(found).all()
    return float((np.abs(found - expected) > rtol * np.abs(expected) + atol).mean())


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("kind", KINDS)
class TestAgainstMitsuba:
    @pytest.mark.sparse(3)
    def test_density_and_shadowing(self, kind: str, alpha: tuple[float, float]) -> None:
        a, b = ours(kind, alpha), theirs(kind, alpha)
        wi, v = hemisphere(0), sphere(1)
        sampled = np.array(b.sample(mi.Vector3f(wi), mi.Point2f(numbers(2, 2)))[0])
        for m in (sampled, sphere(3)):
            pairs = [
                (a.eval(Vector3f(m)), b.eval(mi.Vector3f(m))),
                (a.smith_g1(Vector3f(v), Vector3f(m)), b.smith_g1(mi.Vector3f(v), mi.Vector3f(m))),
                (a.G(Vector3f(wi), Vector3f(v), Vector3f(m)), b.G(mi.Vector3f(wi), mi.Vector3f(v), mi.Vector3f(m))),
                (a.pdf(Vector3f(wi), Vector3f(m)), b.pdf(mi.Vector3f(wi), mi.Vector3f(m))),
            ]
            for found, expected in pairs:
                assert share_beyond(found, expected, 1e-4, 1e-7) == 0

    @pytest.mark.sparse(4)
    @pytest.mark.parametrize("visible", [True, False])
    def test_samples(self, kind: str, alpha: tuple[float, float], visible: bool) -> None:
        wi, sample = hemisphere(4), numbers(2, 5)
        m, pdf = ours(kind, alpha, visible).sample(Vector3f(wi), Point2f(sample))
        m_theirs, pdf_theirs = theirs(kind, alpha, visible).sample(mi.Vector3f(wi), mi.Point2f(sample))
        # Mitsuba gets sin theta from 1 - cos^2, which leaves three digits of slopes of 1e-4.
        coarse = not visible and alpha == (0.0, 0.0)
        assert share_beyond(m, m_theirs, 0, 5e-4 if coarse else 2e-5) < 2e-3
        assert share_beyond(pdf, pdf_theirs, 1e-3, 1e-6) < 2e-3


@pytest.mark.parametrize("kind", KINDS)
def test_below_and_at_the_horizon(kind: str) -> None:
    """Nothing is seen there, and nothing but numbers comes out."""
    below = sphere(6)
    below[2] = -np.abs(below[2])
    below[:, :4] = [[1, 0, 0, 0.6], [0, 1, 0, 0.8], [0, 0, -1, 0]]
    for visible in (True, False):
        surface = ours(kind, (0.2, 0.4), visible)
        m, pdf = surface.sample(Vector3f(below), Point2f(numbers(2, 7)))
        assert np.isfinite(np.array(m)).all()
        assert np.isfinite(np.array(pdf)).all()
    assert not np.array(surface.eval(Vector3f(below))).any()
    # From above the fronts of microfacets are seen, from below the backs.
    for v, hidden in ((Vector3f(below), Vector3f(below)), (Vector3f(hemisphere(8)), Vector3f(-hemisphere(8)))):
        assert not np.array(surface.smith_g1(v, hidden)).any()
        assert (np.array(surface.smith_g1_over_cos(v)) > 0).all()


@pytest.mark.parametrize("corner", [0.0, 1 - 2**-24])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(2)
def test_corners_of_the_square(kind: str, corner: float) -> None:
    for visible in (True, False):
        for other in (0.0, 0.25, 0.5, 0.75, 1 - 2**-24):
            for sample in (Point2f(corner, other), Point2f(other, corner)):
                m, pdf = ours(kind, (0.3, 0.6), visible).sample(Vector3f(0.6, 0, 0.8), sample)
                assert np.linalg.norm(np.array(m)) == pytest.approx(1, abs=1e-6)
                assert np.isfinite(np.array(pdf)).all()


def grid(count: int) -> tuple[Vector3f, Float]:
    """Midpoints of equal steps of both angles over the upper hemisphere, and their solid angles."""
    i, j = dr.meshgrid(dr.arange(Float, count), dr.arange(Float, count))
    step = dr.pi / 2 / count
    sin_theta, cos_theta = dr.sincos((i + 0.5) * step)
    sin_phi, cos_phi = dr.sincos((j + 0.5) * (4 * step))
    return Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta), 4 * step**2 * sin_theta


@pytest.mark.parametrize("alpha", [(0.3, 0.3), (0.9, 0.25)])
@pytest.mark.parametrize("kind", KINDS)
class TestIntegrals:
    def test_facets_cover_the_surface(self, kind: str, alpha: tuple[float, float]) -> None:
        m, area = grid(1024)
        assert dr.sum(ours(kind, alpha).eval(m) * m.z * area)[0] == pytest.approx(1, abs=2e-3)

    @pytest.mark.parametrize("wi", [(0, 0, 1), (0.6, 0.64, 0.48), (0.99, 0.1, 0.1)])
    def test_visible_normals(self, kind: str, alpha: tuple[float, float], wi: Any) -> None:
        """The projected area that is seen is that of the surface: what defines G1 (Heitz, JCGT 3(2), 2014)."""
        m, area = grid(1024)
        density = ours(kind, alpha).pdf(dr.normalize(Vector3f(*wi)), m)
        # Beckmann's G1 is a fit.
        assert dr.sum(density * area)[0] == pytest.approx(1, abs=2e-3 if kind == "ggx" else 8e-3)

    @pytest.mark.parametrize("visible", [True, False])
    def test_samples_have_their_density(self, kind: str, alpha: tuple[float, float], visible: bool) -> None:
        """The density is one over the Jacobian of the map from the square, by forward differentiation."""
        columns = []
        for k in range(2):
            sample = Point2f(numbers(2, 9))
            dr.enable_grad(sample)
            dr.set_grad(sample, Point2f(float(k == 0), float(k == 1)))
            m, pdf = ours(kind, alpha, visible).sample(Vector3f(0.6, 0, 0.8), sample)
            columns.append(dr.forward_to(m))
        jacobian = np.array(dr.norm(dr.cross(*columns)), np.float64)
        error = np.abs(jacobian * np.array(dr.detach(pdf)) - 1)
        # Newton's iteration isn't differentiated where it starts: Beckmann's is a little off.
        assert np.quantile(error, 0.98) < 2e-2


def test_scaled() -> None:
    m = Vector3f(hemisphere(10))
    for alpha in ((0.2, 0.2), (0.2, 0.3)):
        scaled = ours("ggx", alpha).scaled(Float(1.5))
        expected = ours("ggx", (1.5 * alpha[0], 1.5 * alpha[1]))
        np.testing.assert_allclose(np.array(scaled.eval(m)), np.array(expected.eval(m)), rtol=1e-5)
        assert scaled.isotropic == (alpha[0] == alpha[1])


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_by_alpha(kind: str) -> None:
    m, v = Vector3f(hemisphere(11)), Vector3f(sphere(12))

    def values(u: Any, w: Any) -> Any:
        surface = MicrofacetDistribution(kind, u, w)
        return Vector3f(surface.eval(m), surface.smith_g1(v, m), surface.smith_g1_over_cos(v))

    u, w = Float(0.4), Float(0.7)
    dr.enable_grad(u)
    found = values(u, w)
    dr.forward(u)
    expected = quotient(lambda x: np.array(values(Float(0.4 + x), w)), 1e-2)
    found = np.array(dr.grad(found))
    assert np.isfinite(found).all()
    assert (np.abs(found - expected) > 2e-2 * np.abs(expected) + 5e-3).mean() < 5e-3


def rough(**keys: Any) -> Any:
    return djpt.load_dict({"type": "roughconductor", **keys})


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"alpha": -0.1}, r"'alpha' must lie in \[0, 1\], found -0.1"),
        ({"alpha": 1.5}, r"'alpha' must lie in \[0, 1\], found 1.5"),
        ({"alpha_u": 0.1, "alpha_v": 1.1}, r"'alpha_v' must lie in \[0, 1\], found 1.1"),
        ({"distribution": "beckman"}, "'distribution' can't be 'beckman'; did you mean 'beckmann'?"),
        ({"distribution": "phong"}, "'distribution' can't be 'phong'; possible: beckmann, ggx"),
        ({"alpha": 0.1, "alpha_u": 0.1}, "'alpha' can't be combined with 'alpha_u': give either"),
        ({"alpha_v": 0.1}, "'alpha_v' needs 'alpha_u' as well; 'alpha' sets both"),
    ],
)
def test_errors(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.SceneError, match=message):
        rough(**keys)


def test_distribution_in_any_case() -> None:
    assert rough(distribution="GGX").distribution == "ggx"
