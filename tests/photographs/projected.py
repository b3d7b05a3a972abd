"""Where sensors show points, and where OpenCV does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.jit.types import Point2f, Point3f
from tests.kit.photographs import PLACES, rotation

__all__ = ["points_before", "require_as_in_opencv", "shown"]


def points_before(number: int, count: int = 200) -> np.ndarray:
    """Points (N, 3) in the world that the camera of a place sees."""
    turn, move = PLACES[number]
    rng = np.random.default_rng(number)
    seen = np.concatenate([rng.uniform(-0.4, 0.4, (count, 2)), np.ones((count, 1))], axis=1)
    return (seen * rng.uniform(2, 5, (count, 1)) - move) @ rotation(turn)


def shown(view: Any, points: np.ndarray) -> np.ndarray:
    """The pixels (N, 2) at which the sensor of a photograph shows points; NaN for those that it doesn't show."""
    sensor = djpt.load_dict(view.sensor())
    ds, importance = sensor.sample_wi(Point3f(points.T.astype(np.float32)), Point2f(0.5))
    pixels = np.array(ds.uv, np.float64).T * [view.lens.width, view.lens.height]
    return np.where(np.array(importance)[:, None] > 0, pixels, np.nan)


def require_as_in_opencv(views: Any, matrix: Any, coefficients: Any, fisheye: bool = False) -> None:
    """All places: pixels are those of `projectPoints`, whose principal point counts from the corner here."""
    cv2 = pytest.importorskip("cv2")
    assert len(views) == len(PLACES)
    for n, (view, (turn, move)) in enumerate(zip(views, PLACES, strict=True)):
        points = points_before(n)
        arguments = (np.array(turn), np.array(move), np.array(matrix, np.float64), np.array(coefficients, np.float64))
        if fisheye:
            expected = cv2.fisheye.projectPoints(points[:, None], *arguments)[0][:, 0]
        else:
            expected = cv2.projectPoints(points, *arguments)[0][:, 0]
        inside = ((expected > 0.1) & (expected < np.array([view.lens.width, view.lens.height]) - 0.1)).all(axis=1)
        assert inside.sum() > 100
        np.testing.assert_allclose(shown(view, points)[inside], expected[inside], atol=1e-4)
