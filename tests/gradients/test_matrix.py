"""The cells of the gradient matrix: none may be wrong."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.gradients.cells import SEEDS
from tests.gradients.matrix import CELLS

QUICK = (
    "a camera: perspective, aside, point, direct_projective",
    "a light that moves: map, turn, direct_projective",
    "a material: normalmap-diffuse, normalmap.data, prb",
    "a material: roughplastic-colour, diffuse_reflectance.value, prb",
    "a medium: homogeneous, scale, prbvolpath",
)


SCENES = (
    "a camera before a scene: a textured mesh, turn, direct_projective",
    "a camera before a scene: overlapping bodies, turn, prb_projective",
    "a camera before a scene: a lens, turn, direct_projective",
    "a camera before a scene: soft shadows, x_fov, direct_projective",
)

MOST_SAMPLES = 2048


@pytest.mark.slow
@pytest.mark.parametrize("label", CELLS)
def test_no_derivative_is_wrong(label: str) -> None:
    """By the fewest seeds, and not too many samples; the page is made from as many as it takes."""
    cell = CELLS[label]
    spp, spp_difference = (min(count, MOST_SAMPLES) for count in (cell.spp, cell.spp_difference))
    outcome = replace(cell, spp=spp, spp_difference=spp_difference).measured(SEEDS, 2)
    assert outcome.verdict in ("right", "refused", "noisy"), outcome


@pytest.mark.parametrize("label", QUICK)
@pytest.mark.sparse(3)
def test_derivatives_are_right(label: str) -> None:
    outcome = CELLS[label].measured()
    assert outcome.verdict == "right", outcome


@pytest.mark.parametrize("label", SCENES)
@pytest.mark.sparse(4)
def test_cameras_before_scenes_are_right_within_the_noise_of_few_samples(label: str) -> None:
    outcome = replace(CELLS[label], spp=64, spp_difference=256).measured(SEEDS)
    assert outcome.verdict in ("right", "noisy"), outcome
    assert outcome.error < 0.1 * abs(outcome.expected)


def test_the_matrix_is_large_enough() -> None:
    assert len(CELLS) >= 200 and len({cell.group for cell in CELLS.values()}) >= 8


def test_what_has_no_derivative_is_refused() -> None:
    outcome = CELLS["a material that moves: glass, mesh, map, direct_projective"].measured()
    assert outcome.verdict == "refused" and "'face_normals'" in outcome.reason
