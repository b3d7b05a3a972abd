"""Tone mapping: published values, and what every operator promises."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import djpt
from djpt.images.colorimetry import XYZ_TO_RGB, black_body_xyz
from djpt.images.tone_mapping import OPERATORS, balance_matrix, log_average, tonemap

LIGHT = np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 200)])


def greys(levels: Any) -> np.ndarray:
    return np.float32(levels).reshape(1, -1, 1).repeat(3, axis=2)


@pytest.mark.parametrize("operator", OPERATORS)
def test_grey_stays_grey_and_brighter_never_gets_darker(operator: str) -> None:
    shown = tonemap(greys(LIGHT), operator)
    assert shown.dtype == np.float32
    np.testing.assert_allclose(shown, shown[..., :1].repeat(3, axis=2), atol=3e-5)
    assert shown.min() == 0 and shown[0, 0].max() == 0
    assert shown.max() > 0.95
    assert np.all(np.diff(shown[0, :, 1]) >= -1e-7)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(sorted(OPERATORS)),
    st.lists(st.floats(width=32), min_size=3, max_size=3),
    st.sampled_from([-20.0, 0.0, 3.5, "auto"]),
)
def test_every_number_becomes_one_in_the_range(operator: str, rgb: list[float], exposure: Any) -> None:
    image = np.float32(rgb).reshape(1, 1, 3)
    for balance in (None, 3200):
        shown = tonemap(image, operator, exposure, balance)
        assert np.all((shown >= 0) & (shown <= 1))


def test_infinite_light_is_white() -> None:
    for operator in OPERATORS:
        shown = tonemap(np.full((1, 1, 3), np.inf, np.float32), operator)
        assert shown.min() > 0.98, operator


def test_srgb_clips_and_nothing_else() -> None:
    image = np.float32([[[0.2, 1.5, -1.0]]])
    np.testing.assert_array_equal(tonemap(image), np.float32([[[0.2, 1.0, 0.0]]]))


def test_reinhard_maps_luminance() -> None:
    image = np.float32([[[0.3, 2.0, 0.1], [4, 4, 4]]])
    for white in (math.inf, 4.0):
        shown = tonemap(image, "reinhard", white=white)
        luminance = image @ np.float32([0.212671, 0.715160, 0.072169])
        expected = luminance * (1 + luminance / white**2) / (1 + luminance)
        np.testing.assert_allclose(shown @ np.float32([0.212671, 0.715160, 0.072169]), expected, rtol=1e-5)
        np.testing.assert_allclose(shown[0, 0] / shown[0, 0, 0], image[0, 0] / image[0, 0, 0], rtol=1e-5)
    np.testing.assert_allclose(shown[0, 1], 1, rtol=1e-6)


def test_aces_is_the_published_curve() -> None:
    """The matrices leave grey alone, so the rational function alone decides."""
    x = np.array([0.05, 0.18, 1.0, 5.0])
    curve = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081)
    np.testing.assert_allclose(tonemap(greys(x), "aces")[0, :, 0], curve, rtol=1e-4)


def test_agx_shows_middle_grey_in_the_middle() -> None:
    """0.18 lies at (log2 0.18 + 12.47393) / 16.5 = 0.606 of the range, 0.4615 on the curve, 0.4615^2.2 of the light."""
    x = (math.log2(0.18) + 12.47393) / (4.026069 + 12.47393)
    curve = 15.5 * x**6 - 40.14 * x**5 + 31.96 * x**4 - 6.868 * x**3 + 0.4298 * x**2 + 0.1191 * x - 0.00232
    assert tonemap(greys([0.18]), "agx")[0, 0, 1] == pytest.approx(curve**2.2, rel=1e-4)
    assert 0.16 < curve**2.2 < 0.22


@pytest.mark.parametrize("operator", ["aces", "agx"])
def test_bright_colours_turn_pale(operator: str) -> None:
    def saturation(level: float) -> float:
        shown = tonemap(np.float32([[[level, 0.1 * level, 0.1 * level]]]), operator)[0, 0]
        return float(1 - shown.min() / shown.max())

    assert saturation(30.0) < 0.6 * saturation(0.3)


# ---------------------------------------------------------------- exposure


def test_a_stop_doubles_light() -> None:
    image = greys(LIGHT)
    for operator in OPERATORS:
        np.testing.assert_allclose(tonemap(image, operator, 2.0), tonemap(4 * image, operator), atol=1e-6)


def test_auto_exposure_makes_the_log_average_middle_grey() -> None:
    rng = np.random.default_rng(1)
    image = np.exp(rng.normal(3, 0.5, (20, 30, 3))).astype(np.float32)
    shown = tonemap(image, exposure="auto").astype(np.float64)
    assert log_average(shown) == pytest.approx(0.18, rel=1e-2)
    np.testing.assert_allclose(tonemap(image, "agx", "auto"), tonemap(image * 1e-3, "agx", "auto"), atol=1e-5)
    spoiled = image.copy()
    spoiled[0, 0] = np.inf
    np.testing.assert_allclose(tonemap(spoiled, exposure="auto")[1:], shown[1:], rtol=2e-2)
    assert tonemap(np.zeros((2, 2, 3), np.float32), exposure="auto").max() == 0


# ---------------------------------------------------------------- white balance


@pytest.mark.parametrize("white", [[1.0, 0.7, 0.4], [0.5, 0.6, 1.0], 2700.0, 9000])
def test_the_given_light_becomes_white(white: Any) -> None:
    rgb = np.array(white) if isinstance(white, list) else XYZ_TO_RGB @ black_body_xyz(white)
    balanced = balance_matrix(white) @ rgb
    np.testing.assert_allclose(balanced, balanced[0], rtol=1e-6)
    luminance = np.array([0.212671, 0.715160, 0.072169])
    assert balanced @ luminance == pytest.approx(rgb @ luminance, rel=1e-5)


def test_the_white_of_srgb_changes_nothing() -> None:
    np.testing.assert_allclose(balance_matrix([0.4, 0.4, 0.4]), np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("kelvin", "x", "y"),
    [(2856, 0.4476, 0.4074), (6500, 0.3135, 0.3237), (1500, 0.5857, 0.3931), (25000, 0.2525, 0.2522)],
)
def test_the_black_body_locus(kelvin: float, x: float, y: float) -> None:
    """Chromaticities of the Planckian locus (CIE 15, Wyszecki and Stiles); 2856 K is illuminant A."""
    xyz = black_body_xyz(kelvin)
    np.testing.assert_allclose((xyz / xyz.sum())[:2], [x, y], atol=1.5e-3)


# ---------------------------------------------------------------- kinds of images, errors


def test_channels_and_kinds() -> None:
    rng = np.random.default_rng(0)
    for shape in [(4, 5), (4, 5, 1), (4, 5, 2), (4, 5, 3), (4, 5, 4)]:
        image = rng.random(shape).astype(np.float32) * 3
        shown = tonemap(image, "reinhard")
        assert shown.shape == shape and isinstance(shown, np.ndarray)
        if shape[2:] in ((2,), (4,)):
            np.testing.assert_array_equal(shown[..., -1], image[..., -1])
    tensor = djpt.TensorXf(image)
    assert isinstance(tonemap(tensor, "agx"), djpt.TensorXf)
    np.testing.assert_array_equal(tonemap(tensor, "agx").numpy(), tonemap(image, "agx"))
    assert isinstance(tonemap(djpt.Image(image), "aces"), djpt.Image)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"operator": "reinhart"}, "did you mean 'reinhard'"),
        ({"exposure": "bright"}, "a number of stops from -100 to 100, or 'auto', found 'bright'"),
        ({"exposure": math.nan}, "found nan"),
        ({"white_balance": 20}, "a temperature from 1000 to 40000 kelvin"),
        ({"white_balance": [1, 0]}, r"found \[1, 0\]"),
        ({"white_balance": [0, 0, 0]}, "three numbers"),
        ({"white_balance": "warm"}, "found 'warm'"),
        ({"white_balance": [1, -1, 1]}, "not negative"),
        ({"white": 0}, "'white' must be greater than 0"),
        ({"image": np.zeros((2, 2, 7), np.float32)}, "1 to 4 channels, found 7"),
        ({"image": np.zeros((2, 2, 3), np.uint8)}, "8-bit pixels"),
        ({"image": np.zeros((2, 2), np.float32), "white_balance": 3000}, "needs colours"),
    ],
)
def test_wrong_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(djpt.RenderError, match=message):
        tonemap(**{"image": np.zeros((2, 2, 3), np.float32), **arguments})
