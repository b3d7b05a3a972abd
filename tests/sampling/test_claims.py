"""Warps, shapes, filters, textures and samplers, tested by what they claim of themselves.

The tests are parametrised over the registry: a new plugin is tested as soon as it is registered.
Parameters stand in tests/kit/plugins.py. BSDFs and emitters have files of their own:
tests/materials/test_sampling.py, tests/lights/test_sampling.py.
"""

from __future__ import annotations

import inspect
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core import warp
from djpt.description import registry
from djpt.jit.types import Color3f, Float, Point2f
from tests.kit.chi_squared import PLANE, SIGNIFICANCE, SPHERE, p_value, uniform
from tests.kit.one_light import lit, local_frame
from tests.kit.plugins import examples

COUNT = 2**18


# ---------------------------------------------------------------- warps

OTHERS = {
    "square_to_uniform_square_concentric",  # from square to square: it has no density
    "square_to_bilinear",  # the sample is its last argument
    "square_to_std_normal",  # the whole plane
    "square_to_rough_fiber",  # takes three numbers
}
"""Warps of other forms: see tests/scripting/test_warps.py and test_chi2.py."""

WARPS = [
    name for name in warp.__all__ if name.startswith("square_to_") and not name.endswith("_pdf") and name not in OTHERS
]
WARP_ARGUMENTS: dict[str, list[tuple[Any, ...]]] = {
    "square_to_uniform_cone": [(0.3,), (0.9,), (-0.5,)],
    "square_to_beckmann": [(0.3,), (1.0,)],
    "square_to_von_mises_fisher": [(0.5,), (7.0,)],
    "square_to_uniform_spherical_lune": [((0.0, 0.8, -0.6), (0.0, 0.0, 1.0))],
}
"""What a warp takes besides the sample."""

WARP_CASES = [
    pytest.param(name, arguments, id=f"{name.removeprefix('square_to_')}{list(arguments) or ''}")
    for name in WARPS
    for arguments in WARP_ARGUMENTS.get(name, [()])
]


def warped(name: str, arguments: tuple[Any, ...], sample: Any) -> tuple[Any, Any]:
    """Values of a warp, and its density as a function."""
    density = getattr(warp, f"{name}_pdf")
    return getattr(warp, name)(sample, *arguments), lambda value: density(value, *arguments)


def test_every_warp_has_a_density() -> None:
    assert {f"{name}_pdf" for name in WARPS} <= set(warp.__all__)
    for name in WARPS:
        parameters = len(inspect.signature(getattr(warp, name)).parameters) - 1
        assert {len(a) for a in WARP_ARGUMENTS.get(name, [()])} == {parameters}, f"add {name} to WARP_ARGUMENTS"


@pytest.mark.sparse(12)
@pytest.mark.parametrize(("name", "arguments"), WARP_CASES)
def test_warp_follows_its_density(name: str, arguments: tuple[Any, ...]) -> None:
    values, density = warped(name, arguments, Point2f(*uniform(COUNT)))
    p, integral = p_value(SPHERE if len(values) == 3 else PLANE, values, True, density, fine=60)
    assert integral == pytest.approx(1, abs=5e-3)
    assert p > SIGNIFICANCE


@pytest.mark.parametrize(("name", "arguments"), WARP_CASES)
@pytest.mark.sparse(3)
def test_density_is_the_inverse_jacobian(name: str, arguments: tuple[Any, ...]) -> None:
    """1 / pdf = the area that a unit of the square is stretched to, by forward differentiation."""
    u, v = uniform(4096, seed=1)
    columns = []
    for k in range(2):
        sample = Point2f(Float(u), Float(v))
        dr.enable_grad(sample)
        dr.set_grad(sample, Point2f(float(k == 0), float(k == 1)))
        values, density = warped(name, arguments, sample)
        # Values that others depend on would be cleared by the default flags.
        columns.append(np.array(dr.forward_to(values, flags=dr.ADFlag.ClearEdges), np.float64).T)
    if len(values) == 2:
        columns = [np.pad(column, ((0, 0), (0, 1))) for column in columns]
    area = np.linalg.norm(np.cross(*columns), axis=1)
    pdf = np.broadcast_to(np.array(density(dr.detach(values)), np.float64), (4096,))
    # Near an edge of the domain float32 loses digits: not more than a few samples.
    error = np.abs(area * pdf - 1)
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.99) < 1e-2


@pytest.mark.parametrize(("name", "arguments"), WARP_CASES)
def test_corners_of_the_square_stay_in_the_domain(name: str, arguments: tuple[Any, ...]) -> None:
    edge = [0.0, 1e-10, 0.25, 0.5, 0.75, 1 - 2**-24]
    sample = Point2f(*(Float(list(x)) for x in zip(*((a, b) for a in edge for b in edge), strict=True)))
    values = np.array(warped(name, arguments, sample)[0], np.float64)
    assert np.isfinite(values).all()
    if len(values) == 3:
        np.testing.assert_allclose(np.linalg.norm(values, axis=0), 1, atol=1e-6)
    else:
        assert np.abs(values).max() <= 1 + 1e-6


# ---------------------------------------------------------------- shapes


def load(description: dict[str, Any]) -> Any:
    return djpt.load_dict(description)


def with_area() -> list[Any]:
    """Examples of the shapes that can draw points uniformly."""
    return [p for p in examples("shape") if registry.lookup("shape", p.values[0]).has_area]


@pytest.mark.sparse(6)
@pytest.mark.parametrize(("name", "description"), with_area())
def test_positions_lie_on_the_surface(name: str, description: dict[str, Any]) -> None:
    """Sampled points are found again by a ray straight onto them, with the same normal and uv."""
    scene = lit(shape=description, light={"type": "point"})
    shape = scene.shapes()[0]
    ps = shape.sample_position(0, Point2f(*uniform(4096, seed=7)))
    outward = ps.n
    step = 1e-2
    si = scene.ray_intersect(djpt.Ray3f(ps.p + outward * step, -outward, maxt=Float(2 * step)))
    found = np.array(si.valid)
    assert found.mean() > 0.995
    scale = 1 + np.abs(np.array(ps.p)).max()
    assert np.abs(np.array(si.p - ps.p))[:, found].max() < 1e-4 * scale
    normal = np.broadcast_to(np.array(ps.n), (3, 4096))
    same_face = (np.array(si.n) * normal).sum(axis=0) > 0.99
    assert same_face[found].mean() > 0.98
    difference = np.abs(np.array(si.uv) - np.array(ps.uv))[:, found & same_face]
    wrapped = np.minimum(difference, 1 - difference)
    assert np.quantile(wrapped, 0.99) < 2e-3
    np.testing.assert_allclose(np.array(ps.pdf * shape.surface_area()), 1, rtol=1e-5)


@pytest.mark.parametrize(("name", "description"), with_area())
def test_positions_are_uniform(name: str, description: dict[str, Any]) -> None:
    """Equal areas get equal shares: moments of the positions against Mitsuba's mesh or its formula."""
    mi = pytest.importorskip("mitsuba")
    if registry.mitsuba_kind_of(name) is None:
        pytest.skip("Mitsuba has no such shape: see tests/geometry/test_classic_shapes.py")
    mine = lit(shape=description).shapes()[0]
    described = djpt.validation.to_mitsuba(description)
    mi.set_variant("llvm_ad_rgb")
    other = mi.load_dict(described)
    sample = uniform(2**16, seed=8)
    assert float(mine.surface_area()[0]) == pytest.approx(float(np.array(other.surface_area()).ravel()[0]), rel=1e-4)
    a = np.array(mine.sample_position(0, Point2f(*sample)).p, np.float64)
    b = np.array(other.sample_position(0, mi.Point2f(*(mi.Float(s) for s in sample))).p, np.float64)
    scale = b.std(axis=1, keepdims=True).max()
    np.testing.assert_allclose(a.mean(axis=1), b.mean(axis=1), atol=0.02 * scale)
    np.testing.assert_allclose(np.cov(a), np.cov(b), atol=0.02 * scale**2)


# ---------------------------------------------------------------- reconstruction filters


@pytest.mark.parametrize(("name", "description"), examples("rfilter"))
class TestFilter:
    def test_is_even_and_ends(self, name: str, description: dict[str, Any]) -> None:
        rfilter = load(description)
        x = np.linspace(0, rfilter.radius() - 1e-3, 501, dtype=np.float32)
        w = np.array(rfilter.eval(Float(x)), np.float64)
        np.testing.assert_array_equal(np.array(rfilter.eval(Float(-x))), w.astype(np.float32))
        beyond = np.array(rfilter.eval(Float(np.linspace(rfilter.radius() + 1e-3, rfilter.radius() + 3, 100))))
        assert np.abs(beyond).max() <= 2e-5
        assert w.argmax() == 0
        assert w.sum() > 0

    def test_is_mitsubas(self, name: str, description: dict[str, Any]) -> None:
        mi = pytest.importorskip("mitsuba")
        mi.set_variant("llvm_ad_rgb")
        rfilter, other = load(description), mi.load_dict(djpt.validation.to_mitsuba(description))
        assert rfilter.radius() == pytest.approx(float(other.radius()))
        x = np.linspace(-rfilter.radius(), rfilter.radius(), 999, dtype=np.float32)[1:-1]
        expected = np.array(other.eval(mi.Float(x)))
        np.testing.assert_allclose(np.array(rfilter.eval(Float(x))), expected, atol=2.5e-5)


# ---------------------------------------------------------------- textures


@pytest.mark.parametrize(("name", "description"), examples("texture"))
def test_textures_have_the_mean_they_claim(name: str, description: dict[str, Any]) -> None:
    if name == "rgb":
        description = {"type": "rgb", "value": [0.2, 0.4, 0.9]}
    texture, si = load({"type": "diffuse", "reflectance": description}).reflectance, local_frame((0, 0, 1), 4096)
    si.uv = Point2f(*uniform(4096))
    color = texture.eval(si)
    assert isinstance(color, Color3f)
    assert float(np.mean(np.array(color))) == pytest.approx(float(texture.mean()[0]), rel=0.02)
