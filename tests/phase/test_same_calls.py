"""Phase functions: the same calls, the same results as in Mitsuba."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.phase.sggx import sggx_pdf, sggx_projected_area, sggx_sample
from tests.kit.phases import FLAKES, PHASES, described, directions, interaction
from tests.kit.same_calls import same

COUNT = 512
WITHOUT_COMPONENTS = {"rayleigh", "blend", "one end", *FLAKES}
"""Mitsuba 3.9.1 counts no component of Rayleigh's and of flakes, nor where they are blended."""


def numbers(seed: int) -> np.ndarray:
    """Three uniform numbers per lane."""
    return np.random.default_rng(seed).random((3, COUNT), dtype=np.float32)


@pytest.mark.parametrize("name", PHASES)
def test_values_and_densities(mi: Any, name: str) -> None:
    def ask(module: Any) -> Any:
        phase = module.load_dict(described(name, module))
        mei, ctx = interaction(module, directions(COUNT, 1)), module.PhaseFunctionContext()
        return *phase.eval_pdf(ctx, mei, module.Vector3f(directions(COUNT, 2))), phase.projected_area(mei)

    same(ask, mi, rtol=1e-4)


@pytest.mark.sparse(4)
@pytest.mark.parametrize("name", sorted(set(PHASES) - set(FLAKES)))
def test_samples(mi: Any, name: str) -> None:
    def ask(module: Any) -> Any:
        phase, u = module.load_dict(described(name, module)), numbers(3)
        mei, ctx = interaction(module, directions(COUNT, 1)), module.PhaseFunctionContext()
        return phase.sample(ctx, mei, module.Float(u[0]), module.Point2f(u[1:]))

    # Mitsuba's cosines cancel for small asymmetries: they lose as many digits as those are small.
    same(ask, mi, rtol=1e-2 if name == "peak" else 2e-3, atol=5e-4)


@pytest.mark.parametrize("name", FLAKES)
def test_samples_of_flakes_seen_along_an_axis(mi: Any, name: str) -> None:
    """Mitsuba 3.9.1 turns the matrix the wrong way about: along z it can't be seen."""

    def ask(module: Any) -> Any:
        phase, u = module.load_dict(described(name, module)), numbers(4)
        mei, ctx = interaction(module, [0, 0, 1]), module.PhaseFunctionContext()
        return phase.sample(ctx, mei, module.Float(u[0]), module.Point2f(u[1:]))

    same(ask, mi, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", PHASES)
def test_flags_and_counts(mi: Any, name: str) -> None:
    mine, his = (module.load_dict(described(name, module)) for module in (djpt, mi))
    assert mine.flags() == his.flags() == mine.m_flags or name.startswith(("blend", "one"))
    if name in WITHOUT_COMPONENTS:
        assert mine.component_count() > his.component_count()
        return
    assert mine.component_count() == his.component_count()
    for i in range(his.component_count()):
        assert mine.flags(i) == his.flags(i)


@pytest.mark.parametrize("component", [0, 1])
def test_single_components_of_a_blend(mi: Any, component: int) -> None:
    def ask(module: Any) -> Any:
        blend = {"type": "blendphase", "weight": 0.3, "a": {"type": "hg", "g": 0.5}, "b": {"type": "isotropic"}}
        phase, u = module.load_dict(blend), numbers(5)
        mei, ctx = interaction(module, directions(COUNT, 1)), module.PhaseFunctionContext()
        ctx.component = component
        wo, weight, pdf = phase.sample(ctx, mei, module.Float(u[0]), module.Point2f(u[1:]))
        return wo, weight, pdf, *phase.eval_pdf(ctx, mei, wo)

    same(ask, mi, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", FLAKES)
def test_functions_of_flakes(mi: Any, name: str) -> None:
    s = FLAKES[name]
    wm = directions(COUNT, 6)
    same(lambda m: m.sggx_pdf(m.Vector3f(wm), s), mi, rtol=1e-4)
    same(lambda m: m.sggx_projected_area(m.Vector3f(wm), s), mi)
    same(lambda m: m.sggx_sample(m.Vector3f(0, 0, 1), m.Point2f(numbers(7)[1:]), s), mi, atol=1e-5)
    ours = djpt.SGGXPhaseFunctionParams(s[:3], s[3:])
    other = djpt.SGGXPhaseFunctionParams(ours)
    for params in (s, ours, other):
        assert sggx_pdf([0, 0.6, 0.8], params) == sggx_pdf([0, 0.6, 0.8], s)
        assert sggx_projected_area([0, 0.6, 0.8], params) == sggx_projected_area([0, 0.6, 0.8], s)
        found, expected = (sggx_sample([0, 0.6, 0.8], [0.2, 0.7], x) for x in (params, s))
        np.testing.assert_array_equal(found, expected)


def test_contexts(mi: Any) -> None:
    for module in (djpt, mi):
        ctx = module.PhaseFunctionContext()
        assert (ctx.type_mask, ctx.component, ctx.sampler) == (7, 0xFFFFFFFF, None)
        assert ctx.mode == module.TransportMode.Radiance
        ctx.reverse()
        assert ctx.mode == module.TransportMode.Importance
    assert [int(flag) for flag in djpt.PhaseFunctionFlags if flag] == [1, 2, 4]
