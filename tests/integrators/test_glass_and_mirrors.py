"""Panes, slabs and mirrors: what Fresnel's equations let through, under every integrator that follows them."""

from __future__ import annotations

import pytest

from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.closed_forms.cases import ABOVE, BELOW, area, dielectric, pane
from tests.kit.closed_forms import (
    BY_CHANCE,
    BY_LIGHT_SAMPLES,
    Keys,
    check,
    render,
)

ALONG: list[Keys] = [{"type": "whitted"}, *BY_CHANCE, *BY_LIGHT_SAMPLES[1:4], {"type": "distributed", "split": 1}]
"""Integrators that follow mirrors and panes to where there is light."""


@pytest.mark.sparse(16)
@pytest.mark.parametrize("integrator", ALONG, ids=str)
@pytest.mark.parametrize("depth", [1, 2, 3, 6, 9, 16])
def test_slab_of_glass(depth: int, integrator: Keys) -> None:
    """Light that was reflected inside 0, 1, .. times, as far as `depth` goes.

    Up: R + T^2 R (1 + R^2 + ..), the k-th term after 4 + 2 k edges (the first after 2, R alone). Down:
    T^2 (1 + R^2 + ..), after 3 + 2 k edges.
    """
    r = dielectric(50.0, 1.5)
    t = 1 - r
    up = r * (depth >= 2) + t**2 * r * sum(r ** (2 * k) for k in range(99) if 4 + 2 * k <= depth)
    down = t**2 * sum(r ** (2 * k) for k in range(99) if 3 + 2 * k <= depth)
    slab = pane(
        50.0,
        type="cube",
        to_world=T().translate([0, 0, -0.1]).scale([20, 20, 0.1]),
        bsdf={"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    )
    check(render(slab, integrator, depth, 1024), ABOVE * up + BELOW * down)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("integrator", [*ALONG, {"type": "direct"}], ids=str)
def test_thin_pane(integrator: Keys) -> None:
    """All reflections inside at once: R' = 2 R / (1 + R), T' = 1 - R'."""
    r = dielectric(50.0, 1.5)
    up = 2 * r / (1 + r)
    bsdf = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
    scene = pane(50.0, type="rectangle", to_world=T().scale(20.0), bsdf=bsdf)
    check(render(scene, integrator, 2, 1024), ABOVE * up + BELOW * (1 - up))


@pytest.mark.sparse(2)
@pytest.mark.parametrize("integrator", [*ALONG, {"type": "direct"}], ids=str)
def test_lamp_in_a_mirror(integrator: Keys) -> None:
    """rho e; black without an edge to reach the lamp."""
    bsdf = {"type": "conductor", "material": "none", "specular_reflectance": 0.6}
    scene = pane(45.0, type="rectangle", to_world=T().scale(20.0), bsdf=bsdf)
    scene["lamp"] = {
        "type": "rectangle",
        "to_world": T().look_at(origin=[-2, 0, 2], target=[0, 0, 0], up=[0, 1, 0]).scale(0.2),
        "emitter": area(7.0),
    }
    for depth in (1, 2):
        if integrator["type"] != "direct" or depth == 2:
            check(render(scene, integrator, depth, 16), 0.6 * 7.0 * (depth - 1))
