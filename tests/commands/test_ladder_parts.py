"""Parts of the page that compares all integrators, and the strips of bounces and of samples."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest

from djpt.images.sheets import Tile, captioned_rows, captioned_sheet
from djpt.validation.integrator_comparison.page import (
    ERROR_COLORS,
    LINE,
    Curve,
    chart,
    decimals,
    error_map,
    plain,
    spread,
)
from djpt.validation.integrator_comparison.strips import bounces, pyramid, samples

# ---------------------------------------------------------------- the page


def test_labels_keep_their_distance() -> None:
    wanted = [100.0, 101.0, 99.0, 300.0, 339.0, 338.0]
    places = spread(wanted)
    ordered = sorted(places)
    assert min(b - a for a, b in pairwise(ordered)) >= LINE - 1e-9
    assert np.argsort(places).tolist() == np.argsort(wanted).tolist()
    assert spread([50.0, 200.0]) == [50.0, 200.0]


def test_a_curve_of_slope_minus_one_half_runs_along_the_dotted_lines() -> None:
    points = tuple((float(n), n**-0.5) for n in (1, 4, 16, 64, 256))
    figure = chart("errors", "samples", "RMSE", [Curve("one", 0, points, ("",) * 5)])

    def direction(pattern: str) -> float:
        x0, y0, x1, y1 = map(float, re.findall(pattern, figure)[0])
        return (y1 - y0) / (x1 - x0)

    number = r"(-?[\d.]+)"
    dotted = direction(rf'class="slope" d="M{number} {number}L{number} {number}"')
    drawn = direction(rf'<path d="M{number} {number}L{number} {number}L')
    assert dotted == pytest.approx(drawn, rel=0.02)
    assert "noise of the reference" in chart("e", "x", "y", [Curve("one", 0, points, ("",) * 5)], level=0.1)
    assert "no error above" in chart("e", "x", "y", [Curve("one", 0, ((1.0, 0.0),), ("",))])


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (0.0, "0"),
        (0.05, "0.05"),
        (1.0, "1"),
        (512, "512"),
        (2048, "2.05 k"),
        (1e7, "10 M"),
        (1e-5, "10⁻⁵"),
        (2e-4, "2·10⁻⁴"),
    ],
)
def test_plain_numbers(value: float, written: str) -> None:
    assert plain(value) == written


def test_errors_have_three_digits() -> None:
    assert [decimals(x) for x in (1.234, 0.05678, 0.00012345, 0.0)] == ["1.23", "0.0568", "0.000123", "≈ 0"]


def test_colours_of_errors_get_lighter_evenly() -> None:
    assert np.all(np.diff(ERROR_COLORS @ [0.2126, 0.7152, 0.0722]) > -0.5)
    errors = np.array([[0.0, 1e-9, 1e-3, 1e-1, 7.0]])
    shown = error_map(errors, -3, -1)[0]
    first, last = ERROR_COLORS[0], ERROR_COLORS[-1]
    np.testing.assert_array_equal(shown, [first, first, first, last, last])


# ---------------------------------------------------------------- strips


def test_bounces_add_up() -> None:
    panels = bounces("cornell_box", 4, 8, width=12)
    assert [panel.title for panel in panels] == ["E", "KE", "K^2E", "K^3E", "sum"]
    assert all(panel.picture.shape == (12, 12, 3) for panel in panels)
    brightness = [int(panel.picture.astype(int).sum()) for panel in panels]
    assert brightness[1] > brightness[2] > brightness[3] > 0 and max(brightness) == brightness[4]
    brighter = bounces("cornell_box", 4, 8, width=12, exposure=2)
    assert brighter[3].picture.mean() > 1.3 * panels[3].picture.mean()


def test_samples_have_falling_errors() -> None:
    seen: list[tuple[int, int]] = []
    panels = samples("cornell_box", 64, width=12, repeats=2, progress=lambda done, total: seen.append((done, total)))
    assert [panel.title for panel in panels] == ["1 spp", "16 spp", "64 spp"]
    errors = [float(panel.subtitle.removeprefix("RMSE ")) for panel in panels]
    assert 2 < errors[0] / errors[1] < 8 and 1.2 < errors[1] / errors[2] < 4
    assert seen[-1] == (256 + 2 * (1 + 16 + 64),) * 2 and seen == sorted(seen)


def test_a_strip_holds_its_pictures_in_rows() -> None:
    panels = bounces("cornell_box", 2, 4, width=40)
    row, column = captioned_sheet(panels), captioned_sheet(panels, columns=1)
    assert row.shape[1] > 3 * 40 > column.shape[1] and column.shape[0] > 3 * 40 > row.shape[0]
    for i, panel in enumerate(panels):
        left = 2 + i * 42
        np.testing.assert_array_equal(row[2:42, left : left + 40], panel.picture)


# ---------------------------------------------------------------- strategies


def test_a_pyramid_has_a_row_for_each_length() -> None:
    rows = pyramid("cornell_box", 3, 16, width=12, exposure=0)
    assert [[tile.title for tile in row] for row in rows[:2]] == [
        ["s = 0, t = 3", "s = 1, t = 2", "s = 2, t = 1"],
        ["s = 0, t = 4", "s = 1, t = 3", "s = 2, t = 2", "s = 3, t = 1"],
    ]
    assert [row[0].subtitle for row in rows] == ["weighted", "weighted", "alone", "alone"]
    weighted, alone = rows[0][1].picture.astype(int), rows[2][1].picture.astype(int)
    assert 0 < weighted.sum() < alone.sum() and (weighted <= alone).all()


def test_shorter_rows_stand_in_the_middle() -> None:
    tile = Tile("a", "b", np.full((10, 10, 3), 7, np.uint8))
    page = captioned_rows([[tile], [tile, tile, tile]])
    inked = (page == 7).all(axis=2)
    columns = np.flatnonzero(inked[:20].any(axis=0))
    assert columns.min() + columns.max() + 1 == page.shape[1]
    assert inked.sum() == 400
