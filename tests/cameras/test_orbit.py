"""Movements of the camera that a pointer holds."""

import numpy as np
import pytest

import djpt
from djpt.apps.orbit import OrbitCamera


def camera() -> OrbitCamera:
    look_at = djpt.ScalarTransform4f().look_at(origin=[3, 1, 4], target=[0, 1, 0], up=[0, 1, 0])
    return OrbitCamera.facing(np.array(look_at.matrix), 5)


def test_it_turns_about_what_is_ahead() -> None:
    assert np.allclose(camera().target, [0, 1, 0], atol=1e-6)
    assert np.array_equal(camera().up, [0, 1, 0])
    turned = camera().turned(0.7, 0.3)
    assert np.isclose(turned.distance, 5)
    assert np.allclose(turned.target, [0, 1, 0], atol=1e-6)
    ahead = turned.to_world[:3, 2]
    assert np.allclose(turned.to_world[:3, 3] + 5 * ahead, turned.target, atol=1e-6)
    # The horizon stays level, and the view rises by the pitch.
    assert np.isclose(turned.to_world[1, 0], 0, atol=1e-6)
    assert np.isclose(np.arcsin(ahead[1]), 0.3, atol=1e-6)


def test_turns_add_up_and_keep_shapes() -> None:
    back = camera().turned(0.4, 0.2).turned(0.3, -0.2).turned(-0.7, 0)
    assert np.allclose(back.to_world, camera().to_world, atol=1e-6)
    mirrored = OrbitCamera.facing(camera().to_world @ np.diag([-1.0, 1, 1, 1]), 5)
    assert np.linalg.det(mirrored.turned(1, 1).to_world[:3, :3]) < 0


@pytest.mark.parametrize("pitch", [3, -3])
def test_the_picture_doesnt_tip_over(pitch: float) -> None:
    turned = camera()
    for _ in range(4):
        turned = turned.turned(0.1, pitch)
        assert turned.to_world[1, 1] > 0
    elevation = np.degrees(np.arcsin(turned.to_world[1, 2]))
    assert np.isclose(elevation, np.sign(pitch) * 89, atol=1e-3)


def test_shifts_are_in_the_plane_of_the_picture() -> None:
    shifted = camera().shifted(0.5, 0.25)
    offset = shifted.to_world[:3, 3] - camera().to_world[:3, 3]
    ahead, across = camera().to_world[:3, 2], camera().to_world[:3, 1]
    assert np.isclose(offset @ ahead, 0, atol=1e-6)
    assert np.isclose(offset @ across, 0.25, atol=1e-6)
    assert np.isclose(np.linalg.norm(offset), np.hypot(0.5, 0.25), atol=1e-6)
    assert np.allclose(shifted.target - camera().target, offset)
    # Looking along -z with y up, right is +x.
    plain = OrbitCamera.facing(np.array(djpt.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]).matrix), 4)
    assert plain.shifted(1, 0).to_world[0, 3] > 0.9


def test_nearer_and_larger() -> None:
    near = camera().approached(0.5)
    assert np.isclose(near.distance, 2.5)
    assert np.allclose(near.target, camera().target)
    wide = camera().scaled(2)
    assert np.allclose(wide.to_world[:3, 0], 2 * camera().to_world[:3, 0])
    assert np.allclose(wide.to_world[:3, 2:], camera().to_world[:3, 2:])
