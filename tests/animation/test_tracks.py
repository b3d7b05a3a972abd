"""Tracks: values between keyframes."""

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.animation.tracks import Track, TurningCamera
from djpt.apps.orbit import OrbitCamera
from djpt.errors import ParameterError

T = djpt.ScalarTransform4f


def test_numbers_move_linearly_and_stand_beyond_the_ends() -> None:
    track = Track.parse("10:1;30:2; 20:4")
    assert [track.at(frame) for frame in (0, 10, 15, 20, 25, 30, 99)] == [1, 1, 2.5, 4, 3, 2, 2]
    assert Track.parse("0:1,0,0;4:0,0,1").at(1) == [0.75, 0, 0.25]
    assert Track.of({0: 0.5}).at(7) == 0.5


def test_rotations_move_at_constant_speed() -> None:
    start = T().translate([1, 2, 3]) @ T().rotate([0, 1, 0], 20) @ T().scale([1, 2, 3])
    end = T().translate([5, 2, 3]) @ T().rotate([0, 1, 0], 140) @ T().scale([2, 2, 5])
    track = Track.of({0: start, 4: end})
    for frame in range(5):
        share = frame / 4
        expected = (
            T().translate([1 + 4 * share, 2, 3])
            @ T().rotate([0, 1, 0], 20 + 120 * share)
            @ T().scale([1 + share, 2, 3 + 2 * share])
        )
        assert np.allclose(track.at(frame).matrix, expected.matrix, atol=1e-5)  # type: ignore[union-attr]


@pytest.mark.parametrize("angle", [0, 1e-8, 90, 179.9999, 180])
def test_any_angle(angle: float) -> None:
    end = T().rotate([0.6, 0, 0.8], angle)
    half = Track.of({0: T(), 1: end}).at(0.5)
    matrix = np.array(half.matrix, np.float64)[:3, :3]  # type: ignore[union-attr]
    assert np.allclose(matrix @ matrix, np.array(end.matrix)[:3, :3], atol=1e-5)
    assert np.isclose(np.linalg.det(matrix), 1, atol=1e-5)


def test_mirrored_transforms_stay_mirrored() -> None:
    start = T().scale([-1, 1, 1])
    end = T().rotate([0, 0, 1], 90) @ start
    half = np.array(Track.of({0: start, 2: end}).at(1).matrix)  # type: ignore[union-attr]
    assert np.allclose(half, (T().rotate([0, 0, 1], 45) @ start).matrix, atol=1e-5)


@pytest.mark.parametrize(
    "keyframes", [{}, {0: [1, 2], 1: [1]}, {0: "red"}, {0: float("nan")}, {0: np.zeros((2, 2, 2))}, {float("inf"): 1}]
)
def test_wrong_keyframes(keyframes: dict[float, Any]) -> None:
    with pytest.raises(ParameterError, match="keyframes"):
        Track.of(keyframes)


def test_transforms_that_have_no_way_between_them() -> None:
    with pytest.raises(ParameterError, match="invertible"):
        Track.of({0: T(), 1: T().scale([-1, 1, 1])})


@pytest.mark.parametrize("text", ["", "1", "0:", "0:a", "0:1;0:2", "0:1,2;1:1"])
def test_wrong_texts(text: str) -> None:
    with pytest.raises(ParameterError, match="keyframes"):
        Track.parse(text)


def test_a_camera_that_turns_comes_back() -> None:
    camera = OrbitCamera.facing(np.array(T().look_at([3, 1, 0], [0, 1, 0], [0, 1, 0]).matrix), 3)
    track = TurningCamera(camera, 15)
    assert np.allclose(track.at(24).matrix, camera.to_world, atol=1e-5)
    quarter = np.array(track.at(6).matrix)
    assert np.allclose(quarter[:3, 3], [0, 1, -3], atol=1e-5)
