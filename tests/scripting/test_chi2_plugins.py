"""All BSDFs and emitters follow their densities, by the chi-squared test and the adapters of `djpt.chi2`.

The tests of tests/materials and tests/lights are sharper: their cells are small where densities are high.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any

import drjit as dr
import pytest

import djpt
from djpt.core.frame import Frame3f
from djpt.core.records import BSDFFlags, SurfaceInteraction3f, has_flag
from djpt.mitsuba.chi2 import BSDFAdapter, ChiSquareTest, EmitterAdapter, SphericalDomain
from tests.kit import emitters, materials
from tests.kit.parameter_sets import slow_but_first

WI = [2 / 3, -1 / 3, 2 / 3]
LEVEL = 1e-4
"""Of each test: with about fifty of them, one false alarm in two hundred changes of the random numbers."""

NEED_TANGENTS = ("bumpmap", "normalmap")
"""Perturb the frame of a surface; the adapter's has none."""


class Cap(SphericalDomain):
    """The directions around the middle of some directions, so that cells are small where a light is."""

    def __init__(self, directions: Any) -> None:
        self.frame = Frame3f.from_normal(dr.normalize(dr.detach(dr.mean(directions, axis=1))))
        self.height = 1.2 * (1 - float(dr.min(self.frame.to_local(directions).z)[0]))

    def bounds(self) -> Any:
        return SimpleNamespace(min=[-dr.pi, -1], extents=lambda: [2 * dr.pi, min(self.height, 2)])

    def aspect(self) -> float:
        return 1

    def map_forward(self, p: Any) -> Any:
        return self.frame.to_world(super().map_forward(p))

    def map_backward(self, d: Any) -> Any:
        return super().map_backward(self.frame.to_local(d))


@functools.cache
def flags(name: str) -> int:
    return int(djpt.load_dict(materials.bsdf(name)).flags())


def has_density(name: str) -> bool:
    """Delta lobes have none: the adapter counts their samples all the same."""
    return not has_flag(flags(name), BSDFFlags.Delta | BSDFFlags.Null)


BSDFS = [name for name in materials.NAMES if materials.plugin_of(name) not in NEED_TANGENTS and has_density(name)]
SURROUNDINGS = [name for name in emitters.NAMES if emitters.plugin_of(name) in ("constant", "envmap")]
AREAS = [name for name in emitters.NAMES if emitters.plugin_of(name) == "area"]


def test_what_is_left_out_has_delta_lobes() -> None:
    tested = {materials.plugin_of(name) for name in BSDFS}
    left = set(materials.PLUGINS) - tested - set(NEED_TANGENTS)
    for plugin in left:
        names = [name for name in materials.NAMES if materials.plugin_of(name) == plugin]
        assert all(has_flag(flags(name), BSDFFlags.Delta | BSDFFlags.Null) for name in names), plugin


@pytest.mark.sparse(8)
@pytest.mark.parametrize("name", slow_but_first(BSDFS, materials.plugin_of))
def test_bsdfs(name: str) -> None:
    description = materials.bsdf(name)
    sample, density = BSDFAdapter(description["type"], description, wi=WI, uv=[0.31, 0.62])
    test = ChiSquareTest(SphericalDomain(), sample, density, sample_dim=3, sample_count=50_000, res=51, ires=24)
    assert test.run(significance_level=LEVEL, quiet=True), test.messages


def test_bsdfs_by_text() -> None:
    text = '<string name="distribution" value="ggx"/><float name="alpha" value="%f"/>'
    sample, density = BSDFAdapter("roughconductor", text, wi=WI)
    test = ChiSquareTest(
        SphericalDomain(),
        lambda numbers: sample(numbers, 0.4),
        lambda wo: density(wo, 0.4),
        sample_dim=3,
        sample_count=50_000,
        res=31,
        ires=16,
    )
    assert test.run(significance_level=LEVEL, quiet=True), test.messages


@pytest.mark.parametrize("name", slow_but_first(SURROUNDINGS, emitters.plugin_of))
def test_emitters_around_the_scene(name: str) -> None:
    description = emitters.entry(name)
    sample, density = EmitterAdapter(description["type"], description)
    test = ChiSquareTest(SphericalDomain(), sample, density, sample_count=50_000, res=51, ires=48)
    assert test.run(significance_level=LEVEL, quiet=True), test.messages


@pytest.mark.parametrize("name", slow_but_first(AREAS, emitters.plugin_of))
def test_emitters_on_shapes(name: str) -> None:
    """Of the directions that bring light: points on the back of a closed shape don't count."""
    scene: Any = djpt.load_dict({"type": "scene", "light": emitters.entry(name)})

    def sample(numbers: Any) -> tuple[Any, Any]:
        si = dr.zeros(SurfaceInteraction3f, dr.width(numbers))
        ds, weight = scene.sample_emitter_direction(si, numbers, test_visibility=False)
        return ds.d, dr.select(dr.max(weight) > 0, djpt.Float(1), 0)

    def density(d: Any) -> Any:
        si = dr.zeros(SurfaceInteraction3f, dr.width(d))
        hit = scene.ray_intersect(djpt.Ray3f(si.p, d))
        ds = djpt.DirectionSample3f(scene, hit, si)
        bright = dr.max(hit.emitter(scene).eval(hit)) > 0
        return dr.select(bright, scene.pdf_emitter_direction(si, ds), 0)

    numbers = djpt.PCG32(size=1000)
    domain = Cap(sample(djpt.Point2f(numbers.next_float32(), numbers.next_float32()))[0])
    # The outline of a shape cuts cells: the rule has to be fine to see all that are lit.
    test = ChiSquareTest(domain, sample, density, sample_count=8_000, res=15, ires=120)
    assert test.run(significance_level=LEVEL, quiet=True), test.messages
