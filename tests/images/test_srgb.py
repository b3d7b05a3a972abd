"""Stored pixels and their linear values: tables give what the formulas give, whatever the size of a picture."""

from __future__ import annotations

import numpy as np
import pytest

from djpt.images.srgb import decoded, encoded, from_srgb, shares, to_srgb8


def codes(dtype: type, *shape: int) -> np.ndarray:
    """All numbers of a type in turn, from 0 on."""
    return np.arange(np.prod(shape)).astype(dtype).reshape(shape)


def linear(numbers: np.ndarray) -> np.ndarray:
    """The standard's formula in double precision, rounded once."""
    x = numbers / float(np.iinfo(numbers.dtype).max)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(256, 256, 1), (257, 255, 3), (1, 1, 3), (311, 211, 1)])
def test_tables_hold_the_formula(dtype: type, shape: tuple[int, ...]) -> None:
    stored = codes(dtype, *shape)
    found = from_srgb(stored)
    assert found.dtype == np.float32
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, linear(stored))
    np.testing.assert_array_equal(shares(stored), (stored / np.iinfo(dtype).max).astype(np.float32))


@pytest.mark.parametrize("channels", [2, 4])
def test_alpha_is_linear(channels: int) -> None:
    stored = codes(np.uint8, 150, 151, channels)
    found = from_srgb(stored)
    np.testing.assert_array_equal(found[..., :-1], linear(stored[..., :-1]))
    np.testing.assert_array_equal(found[..., -1], shares(stored)[..., -1])


def test_pixels_need_not_lie_in_a_row() -> None:
    wide = codes(np.uint8, 300, 400, 4)
    for part in (wide[..., :3], wide[::-2, 1:], wide.transpose(1, 0, 2)[..., :1]):
        np.testing.assert_array_equal(shares(part), (part / 255).astype(np.float32))


def test_bytes_survive() -> None:
    stored = codes(np.uint8, 256, 256, 3)
    np.testing.assert_array_equal(to_srgb8(from_srgb(stored)), stored)


def test_the_curve_and_its_inverse() -> None:
    x = np.linspace(-0.5, 2, 1001)
    np.testing.assert_allclose(decoded(encoded(x)), x, atol=1e-6)
