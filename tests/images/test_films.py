"""Films: which samples a pixel sees, and with which weights, at the edges of crops as in Mitsuba with the same seed.

The scene shows depths, which no decision of a path can flip: what differs is the film's doing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.kit.renders import box, ours, theirs

pytest.importorskip("mitsuba")

FILTERS: dict[str, dict[str, Any]] = {
    "box": {"type": "box"},
    "tent": {"type": "tent"},
    "tent, wide": {"type": "tent", "radius": 1.6},
    "tent, narrow": {"type": "tent", "radius": 0.4},
    "gaussian": {"type": "gaussian"},
    "gaussian, wide": {"type": "gaussian", "stddev": 1.0},
    "gaussian, narrow": {"type": "gaussian", "stddev": 0.3},
    "mitchell": {"type": "mitchell"},
    "catmullrom": {"type": "catmullrom"},
    "lanczos": {"type": "lanczos"},
    "lanczos, two lobes": {"type": "lanczos", "lobes": 2},
}

CROPS: dict[str, dict[str, int]] = {
    "whole": {},
    "upper left": {"crop_width": 5, "crop_height": 4},
    "lower right": {"crop_offset_x": 7, "crop_offset_y": 5, "crop_width": 6, "crop_height": 4},
    "inside": {"crop_offset_x": 3, "crop_offset_y": 2, "crop_width": 6, "crop_height": 3},
    "one pixel": {"crop_offset_x": 5, "crop_offset_y": 4, "crop_width": 1, "crop_height": 1},
}


@pytest.mark.sparse(138)
@pytest.mark.parametrize("sample_border", [False, True], ids=["", "border"])
@pytest.mark.parametrize("crop", CROPS.values(), ids=CROPS)
@pytest.mark.parametrize("rfilter", FILTERS.values(), ids=FILTERS)
def test_every_pixel_is_mitsubas(rfilter: dict[str, Any], crop: dict[str, int], sample_border: bool) -> None:
    scene = box((13, 9), rfilter, {"type": "depth"}, None, sample_border=sample_border, **crop)
    image, reference = ours(scene, 16, 5), theirs(scene, 16, 5)
    assert image.shape == reference.shape
    error = np.abs(image - reference) / np.abs(reference).mean()
    edge = np.ones(error.shape, bool)
    edge[2:-2, 2:-2] = False
    # Measured: at most 1.2e-5 on average (the narrow gaussian, whose fit cancels), 5e-7 for all others.
    assert error[edge].mean() < 1e-4
    assert error.mean() < 1e-4
    assert error.max() < 1e-3


def test_banners_of_old_files_are_ignored_as_in_mitsuba() -> None:
    plain, with_banner = (box(6, **film) for film in ({}, {"banner": True}))
    np.testing.assert_array_equal(ours(plain), ours(with_banner))
    np.testing.assert_array_equal(theirs(plain), theirs(with_banner))
