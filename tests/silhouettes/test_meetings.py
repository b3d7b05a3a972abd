"""Where two surfaces meet, as rays next to each other show: scenes of any size have the same curves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.records import Ray3f
from djpt.integrators.projective.crossings import touch
from djpt.jit.types import Bool, Point3f, Vector3f

APART = 1e-6
"""The angle between the rays."""


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
@pytest.mark.parametrize(("height", "meet"), [(0.0, True), (0.01, False), (0.2, False)])
def test_an_outline_close_to_a_floor_is_not_where_they_meet(size: float, height: float, meet: bool) -> None:
    """A ball that a floor cuts at its equator: its outline, seen from the side, begins where they meet."""
    scene = djpt.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "radius": size},
            "floor": {"type": "rectangle", "to_world": djpt.ScalarTransform4f().scale(20 * size)},
        }
    )
    eye = np.array([0, -6.0, 1.5])
    edge = outline(eye, height)
    rays = [beside(eye, edge, side) for side in (-APART, APART)]
    a, b = (hit(scene, size * eye, d) for d in rays)
    assert int(a.shape_index[0]) != int(b.shape_index[0])
    assert bool(touch(a, b, *map(Vector3f, rays))[0]) == meet


def outline(eye: Any, height: float) -> Any:
    """The point of the outline of the unit ball at a height; at height 0, one before it on the floor."""
    if height == 0:
        return np.array([np.sin(0.4), -np.cos(0.4), 0.0])
    # The points p of the outline satisfy <p, eye> = 1.
    y = (1 - height * eye[2]) / eye[1]
    return np.array([np.sqrt(1 - y**2 - height**2), y, height])


def beside(eye: Any, edge: Any, angle: float) -> Any:
    """The direction from the eye to an edge, turned a little across it."""
    d = (edge - eye) / np.linalg.norm(edge - eye)
    across = edge - np.dot(edge, d) * d if edge[2] > 0 else np.array([0, 0, 1.0])
    turned = d + angle * across / np.linalg.norm(across)
    return turned / np.linalg.norm(turned)


def hit(scene: Any, eye: Any, d: Any) -> Any:
    """What a ray meets first."""
    return scene.ray_intersect(Ray3f(Point3f(*map(float, eye)), Vector3f(*map(float, d))), active=Bool(True))
