"""Derivatives by the motion of shapes, lights and cameras, case by case: those of central differences."""

from __future__ import annotations

from dataclasses import replace

import pytest

from djpt.core.transforms import ScalarTransform4f as T
from tests.silhouettes import (
    camera_cases,
    cases,
    curve_cases,
    fog_cases,
    hollow_cases,
    light_cases,
    mirror_cases,
    wedge_cases,
)
from tests.silhouettes.cases import INTERIOR, PRB, Case, plate, sensor, sky, turn

CASES = {
    name: case
    for module in (cases, camera_cases, curve_cases, fog_cases, light_cases, mirror_cases, hollow_cases, wedge_cases)
    for name, case in module.CASES.items()
}

QUICK = {
    "a coarse smooth mesh": "direct_projective",
    "a camera, turn: a globe": "prb_projective",
    "a camera in fog, turn": "volpath",
    "the edge of a lamp at the border of the film": "prb_projective",
    "a ball rises from a floor": "direct_projective",
    "a flat mirror": "prb_projective",
    "a bowl with dents": "direct_projective",
    "dents light each other": "prb_projective",
    "a smooth octahedron turns before a low lamp": "prb_projective",
    "the shadow of a ball in the light of a point": "direct_projective",
    "a cup that a floor cuts": "direct_projective",
    "a tube on a floor": "direct_projective",
    "a ball that a floor cuts, indirect light": "prb_projective",
    "a camera, turn: a furrow": "direct_projective",
    "the shadow of strands in the light of a point": "direct_projective",
}
"""What runs before a commit, with few samples; all is run with as many as it asks for by the slow tests."""

FEW, FEW_OF_DIFFERENCES = 256, 4096

EACH = [(name, kind) for name, case in CASES.items() for kind in case.kinds]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), EACH)
def test_derivatives_are_those_of_differences(name: str, kind: str) -> None:
    CASES[name].check(kind, name)


@pytest.mark.parametrize(("name", "kind"), QUICK.items())
def test_some_are_so_within_the_noise_of_few_samples(name: str, kind: str) -> None:
    case = CASES[name]
    spp, spp_difference = min(case.spp, FEW), min(case.spp_difference, FEW_OF_DIFFERENCES)
    replace(case, spp=spp, spp_difference=spp_difference).check(kind, name)


def test_a_mirror_shows_edges_where_they_would_be_behind_it() -> None:
    """The outline of a lamp in a flat mirror moves like that of a lamp behind a window in its place."""
    mirrored = mirror_cases.CASES["a lamp in a mirror"]
    behind = {"type": "disk", "to_world": T().translate([0.3, 0.2, -3]), "emitter": {"type": "area", "radiance": 2.0}}
    window = replace(mirrored, nodes=lambda: {"moving": behind, "sensor": sensor((-3, -1, 5))})
    found, expected = (case.forward("direct_projective", 3) for case in (replace(mirrored, spp=512), window))
    assert found == pytest.approx(expected, rel=0.08)


def test_chains_of_smooth_surfaces() -> None:
    """Two mirrors, and a plate of glass in front: forward and reverse mode carry changes along all of it."""
    case = Case(
        lambda: {
            "moving": {**plate({"type": "conductor"}), "to_world": T().rotate([0, 1, 0], 20).scale(4)},
            "other": {**plate({"type": "conductor"}), "to_world": T().translate([4, 0, 4]).rotate([0, 1, 0], -60)},
            "pane": {**plate({"type": "dielectric"}), "to_world": T().translate([0, 0, 3]).scale(4)},
            "sky": sky(),
        },
        turn("moving.to_world", 10),
        PRB,
        depth=12,
        settings={**INTERIOR, "rr_depth": 100, "unproven_gradients": True},
    )
    forward = case.forward("prb_projective", 3)
    assert abs(forward) > 1 and case.reverse("prb_projective", 3) == pytest.approx(forward, rel=1e-4)
