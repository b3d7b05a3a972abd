"""Frames: the same calls as Mitsuba's, with the same results."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import SceneError

UNIT = [2 / 7, 3 / 7, -6 / 7]
DIRECTIONS = [UNIT, [0, 0, 1], [0, 0, -1], [0.6, 0, 0.8], [0, -0.8, 0.6], [1, 0, 0], [1e-5, 2e-5, 1]]
ANGLES = [
    "cos_theta",
    "cos_theta_2",
    "sin_theta",
    "sin_theta_2",
    "tan_theta",
    "tan_theta_2",
    "sin_phi",
    "sin_phi_2",
    "cos_phi",
    "cos_phi_2",
    "sincos_phi",
    "sincos_phi_2",
]


def assert_same(ours: Any, theirs: Any) -> None:
    np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=3e-6, atol=1e-6)


@pytest.mark.parametrize("name", ANGLES)
@pytest.mark.parametrize("v", DIRECTIONS, ids=str)
def test_angles_are_mitsubas(mi: Any, name: str, v: list[float]) -> None:
    with np.errstate(divide="ignore"):
        for form in (lambda m: v, lambda m: m.Vector3f(v), lambda m: np.array(v)):
            assert_same(getattr(djpt.Frame3f, name)(form(djpt)), getattr(mi.Frame3f, name)(form(mi)))


@pytest.mark.parametrize("n", DIRECTIONS[:5], ids=str)
def test_frames_are_mitsubas(mi: Any, n: list[float]) -> None:
    def axes(m: Any) -> Any:
        frames = [m.Frame3f(n), m.Frame3f(m.Normal3f(n)), m.Frame3f(m.Frame3f(n)), m.Frame3f([1, 2, 3], [0, 1, 0], n)]
        return [axis for frame in frames for axis in (frame.s, frame.t, frame.n)] + list(m.coordinate_system(n))

    assert_same(axes(djpt), axes(mi))
    for name in ("to_local", "to_world"):
        assert_same(*(getattr(m.Frame3f(n), name)([1, 2, 3]) for m in (djpt, mi)))


def test_no_arguments() -> None:
    frame = djpt.Frame3f()
    frame.s, frame.t, frame.n = (djpt.Vector3f(row) for row in np.eye(3))
    assert dr.all(frame == djpt.Frame3f([0, 0, 1]))
    frame.assign(djpt.Frame3f([1, 0, 0]))
    assert dr.all(frame == djpt.Frame3f([1, 0, 0]))


def test_comparison(mi: Any) -> None:
    for m in (djpt, mi):
        frame, lanes = m.Frame3f([0, 0, 1]), m.Frame3f(m.Vector3f([0, 1], 0, [1, 0]))
        assert np.array(frame == lanes).tolist() == [True, False]
        assert np.array(frame != lanes).tolist() == [False, True]
        assert frame != 3


def test_records_of_dr_jit() -> None:
    frame = djpt.Frame3f(djpt.Vector3f([0, 1], 0, [1, 0]))
    assert dr.width(frame) == 2 and dr.width(dr.zeros(djpt.Frame3f, 5).t) == 5
    second = dr.gather(djpt.Frame3f, frame, djpt.UInt32(1))
    assert dr.all(second == djpt.Frame3f([1, 0, 0]))
    chosen = dr.select(djpt.Bool(True, False), djpt.Frame3f([1, 0, 0]), frame)
    assert dr.all(chosen == djpt.Frame3f([1, 0, 0]), axis=None)


def test_refused() -> None:
    with pytest.raises(SceneError, match="takes no axis, the normal, or all three"):
        djpt.Frame3f([1, 0, 0], [0, 1, 0])
    with pytest.raises(SceneError, match="must be three numbers, found str"):
        djpt.Frame3f("x")
