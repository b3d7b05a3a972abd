"""Inside and outside by crossing parity; bounding boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt

T = djpt.ScalarTransform4f


def inside(shapes: dict[str, Any], points: np.ndarray) -> np.ndarray:
    """`Scene.is_inside` of points (N, 3)."""
    scene = djpt.load_dict({"type": "scene", **shapes})
    return np.array(scene.is_inside(djpt.Point3f(points.T)))


def tetrahedron() -> dict[str, Any]:
    """A closed mesh: the corner of the unit cube."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return {"mesh": djpt.Mesh("mesh", vertex_positions=corners, faces=faces)}


POINTS = np.random.default_rng(0).uniform(-1.5, 1.5, (4000, 3))


@pytest.mark.parametrize(
    ("shapes", "expected"),
    [
        ({"a": {"type": "sphere"}}, np.linalg.norm(POINTS, axis=1) < 1),
        ({"a": {"type": "cube"}}, np.abs(POINTS).max(axis=1) < 1),
        (tetrahedron(), (POINTS.min(axis=1) > 0) & (POINTS.sum(axis=1) < 1)),
        # A hollow ball: within both is outside again.
        (
            {"a": {"type": "sphere"}, "b": {"type": "sphere", "radius": 0.5}},
            (np.linalg.norm(POINTS, axis=1) < 1) & (np.linalg.norm(POINTS, axis=1) > 0.5),
        ),
        # An open shape in between doesn't count.
        ({"a": {"type": "sphere"}, "b": {"type": "rectangle"}}, np.linalg.norm(POINTS, axis=1) < 1),
        ({"b": {"type": "rectangle"}}, np.zeros(len(POINTS), bool)),
    ],
    ids=["sphere", "cube", "mesh", "hollow", "with an open shape", "open"],
)
def test_parity(shapes: dict[str, Any], expected: np.ndarray) -> None:
    assert (inside(shapes, POINTS) == expected).mean() > 0.998


def test_open_meshes_have_no_inside() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = djpt.Mesh("mesh", vertex_positions=corners, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2]]))
    assert not inside({"mesh": mesh}, POINTS).any()


def test_many_shapes_in_the_tree() -> None:
    centers = [[3.0 * i, 3.0 * j, 0] for i in range(6) for j in range(6)]
    spheres = {f"s{i}": {"type": "sphere", "center": center} for i, center in enumerate(centers)}
    points = np.random.default_rng(1).uniform(-1, 17, (4000, 3)) * [1, 1, 0.1]
    distance = np.linalg.norm(points[:, None] - np.array(centers)[None], axis=2).min(axis=1)
    assert (inside(spheres, points) == (distance < 1)).mean() > 0.998


def test_bounding_box() -> None:
    scene = djpt.load_dict(
        {"type": "scene", "a": {"type": "sphere", "center": [1, 2, 3], "radius": 2}, **tetrahedron()}
    )
    box = scene.bbox()
    assert np.allclose(box.min, [-1, 0, 0]) and np.allclose(box.max, [3, 4, 5])
    assert np.allclose(box.center(), [1, 2, 2.5]) and np.isclose(box.volume(), 4 * 4 * 5)
    assert np.isclose(box.surface_area(), 2 * (16 + 20 + 20))
    assert box.contains([0, 0, 0]) and not box.contains([0, 0, 5.1])
    assert not djpt.load_dict({"type": "scene"}).bbox().valid()
