"""Bounding boxes and spheres: the same calls as Mitsuba's, with the same results."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import SceneError


def ray(m: Any, o: Any, d: Any) -> Any:
    made = dr.zeros(m.Ray3f)
    made.o, made.d, made.maxt = m.Point3f(o), m.Vector3f(d), m.Float(1e30)
    return made


BOXES = {
    "unit": lambda b: b([0, 0, 0], [1, 1, 1]),
    "long": lambda b: b([1, 2, 3], [2, 3, 5]),
    "point": lambda b: b([0, 1, 2]),
    "point by name": lambda b: b(p=[0, 1, 2]),
    "corners by name": lambda b: b(max=[4, 3, 2], min=[0, 1, 2]),
    "flat": lambda b: b([0, 1, 2], [1, 1, 4]),
    "number": lambda b: b(0, 2),
    "copy": lambda b: b(b([1, 2, 3], (2, 4, 5))),
    "merged": lambda b: b.merge(b([0, 1, 2]), b([1, 2, 3], [2, 3, 5])),
}
QUESTIONS = {
    "min": lambda m, b, k: b.min,
    "max": lambda m, b, k: b.max,
    "valid": lambda m, b, k: b.valid(),
    "collapsed": lambda m, b, k: b.collapsed(),
    "center": lambda m, b, k: b.center(),
    "extents": lambda m, b, k: b.extents(),
    "volume": lambda m, b, k: b.volume(),
    "surface_area": lambda m, b, k: b.surface_area(),
    "major_axis": lambda m, b, k: b.major_axis(),
    "minor_axis": lambda m, b, k: b.minor_axis(),
    "corner 0": lambda m, b, k: b.corner(0),
    "corner 5": lambda m, b, k: b.corner(5),
    "contains a point": lambda m, b, k: b.contains([1, 1, 2]),
    "contains strictly": lambda m, b, k: b.contains(p=[1, 2, 3.5], strict=True),
    "contains a box by name": lambda m, b, k: b.contains(bbox=k([1, 2, 3], [1.5, 2.5, 3.5])),
    "contains a box": lambda m, b, k: b.contains(k([1, 2, 3], [1.5, 2.5, 3.5])),
    "contains a box strictly": lambda m, b, k: b.contains(k([1, 2, 3], [1.5, 2.5, 3.5]), strict=True),
    "overlaps": lambda m, b, k: b.overlaps(k([0, 1, 2], [1, 2, 3])),
    "overlaps strictly": lambda m, b, k: b.overlaps(k([0, 1, 2], [1, 2, 3]), strict=True),
    "distance": lambda m, b, k: b.distance([3, -1, 7]),
    "squared_distance": lambda m, b, k: b.squared_distance([1.2, 2.2, 9]),
    "distance of a box": lambda m, b, k: b.distance(k([4, 5, 6], [7, 7, 7])),
    "squared distance of a box": lambda m, b, k: b.squared_distance(k([1.1, 2.2, 3.3], [1.8, 2.8, 3.8])),
    "sphere's centre": lambda m, b, k: b.bounding_sphere().center,
    "sphere's radius": lambda m, b, k: b.bounding_sphere().radius,
}
RAYS = {
    "through": ([0.5, 0.5, -5], [0, 0, 1]),
    "askew": ([-2, -2, -2], [0.6, 0.5, 0.62]),
    "beside": ([-2, 0.5, 9], [0, 1, 0]),
    "from within": ([0.5, 0.4, 0.3], [-0.6, 0.64, 0.48]),
    "along an edge": ([0, 0, 0], [1, 0, 0]),
    "along another edge": ([1, 1, 1], [0, 1, 0]),
    "away": ([5, 5, 5], [1, 1, 1]),
}
EDITS = {
    "reset": lambda b, k: b.reset(),
    "expand": lambda b, k: b.expand([7, -1, 2]),
    "expand by a box": lambda b, k: b.expand(k([-1, -2, -3], [4, 5, 6])),
    "clip": lambda b, k: b.clip(k([0.25, 0.5, 0.5], [4, 5, 4])),
}


def assert_same(ours: Any, theirs: Any) -> None:
    np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("kind", ["BoundingBox3f", "ScalarBoundingBox3f"])
@pytest.mark.parametrize("build", BOXES.values(), ids=BOXES.keys())
def test_boxes_are_mitsubas(mi: Any, kind: str, build: Any) -> None:
    for what, ask in QUESTIONS.items():
        ours, theirs = (ask(m, build(getattr(m, kind)), getattr(m, kind)) for m in (djpt, mi))
        np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=2e-6, err_msg=what)


@pytest.mark.parametrize("kind", ["BoundingBox3f", "ScalarBoundingBox3f"])
@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS.keys())
def test_edits_are_mitsubas(mi: Any, kind: str, edit: Any) -> None:
    found = []
    for m in (djpt, mi):
        box = getattr(m, kind)([0, 0, 0], [1, 1, 1])
        edit(box, getattr(m, kind))
        found.append(np.stack([np.array(box.min), np.array(box.max)]))
    assert_same(*found)


@pytest.mark.parametrize(("o", "d"), RAYS.values(), ids=RAYS.keys())
def test_rays_are_mitsubas(mi: Any, o: Any, d: Any) -> None:
    for build in (
        lambda m: m.BoundingBox3f([0, 0, 0], [1, 1, 1]),
        lambda m: m.ScalarBoundingBox3f([0, 0, 0], [1, 1, 1]),
        lambda m: m.BoundingSphere3f([0.5, 0.5, 0.5], 1.25),
        lambda m: m.ScalarBoundingSphere3f([0.5, 0.5, 0.5], 0.25),
    ):
        (hit, mint, maxt), (their_hit, their_mint, their_maxt) = (
            build(m).ray_intersect(ray(m, o, d)) for m in (djpt, mi)
        )
        assert hit[0] == their_hit[0]
        if hit[0]:
            assert_same(mint, their_mint)
            assert_same(maxt, their_maxt)


def test_rectangles_are_mitsubas(mi: Any) -> None:
    for kind in ("BoundingBox2f", "ScalarBoundingBox2f"):
        ours, theirs = (getattr(m, kind)([0, 1], [2, 5]) for m in (djpt, mi))
        for name in ("volume", "surface_area", "center", "extents", "major_axis", "minor_axis"):
            assert_same(getattr(ours, name)(), getattr(theirs, name)())
        assert not hasattr(ours, "ray_intersect") and not hasattr(theirs, "ray_intersect")


@pytest.mark.parametrize("kind", ["BoundingSphere3f", "ScalarBoundingSphere3f"])
def test_spheres_are_mitsubas(mi: Any, kind: str) -> None:
    def answers(m: Any) -> list[Any]:
        sphere = getattr(m, kind)([1, 2, 3], 2)
        found = [
            sphere.empty(),
            getattr(m, kind)().empty(),
            sphere.contains([1, 2, 5]),
            sphere.contains([1, 2, 5], strict=True),
        ]
        sphere.expand([1, 2, 9])
        return [*found, sphere.radius, sphere.contains([1, 2, 8.9]), sphere == sphere, sphere == getattr(m, kind)()]

    assert [np.array(x).ravel().tolist() for x in answers(djpt)] == [np.array(x).ravel().tolist() for x in answers(mi)]


@pytest.mark.parametrize("kind", ["ScalarBoundingBox3f", "ScalarBoundingSphere3f"])
def test_texts_are_mitsubas(mi: Any, kind: str) -> None:
    for build in (lambda c: c(), lambda c: c([1, 2, 3], 2)):
        assert repr(build(getattr(djpt, kind))) == repr(build(getattr(mi, kind)))


def test_equality_and_kinds() -> None:
    box = djpt.BoundingBox3f([0, 1, 2], [3, 4, 5])
    assert box == djpt.ScalarBoundingBox3f([0, 1, 2], [3, 4, 5]) != djpt.BoundingBox3f()
    assert djpt.BoundingBox3f(djpt.ScalarBoundingBox3f(0, 3)) != box and box != 3
    low, high = box
    assert list(low) == [0, 1, 2] and dr.all(high == [3, 4, 5])
    assert djpt.BoundingSphere3f(djpt.ScalarBoundingSphere3f([1, 2, 3], 4)) == djpt.BoundingSphere3f([1, 2, 3], 4)


def test_lanes() -> None:
    box = djpt.BoundingBox3f([djpt.Float(0, 1), 0, 0], 2)
    assert dr.width(box) == 2 and np.array(box.volume()).tolist() == [8, 4]
    assert np.array(box.contains([0.5, 0.5, 0.5])).tolist() == [True, False]
    assert dr.gather(djpt.BoundingBox3f, box, djpt.UInt32(1)) == djpt.BoundingBox3f([1, 0, 0], 2)
    assert dr.width(dr.zeros(djpt.BoundingSphere3f, 3)) == 3
    chosen = dr.select(djpt.Bool(True, False), box, djpt.BoundingBox3f(0, 2))
    assert chosen == djpt.BoundingBox3f(0, 2)


def test_what_a_scene_returns(mi: Any) -> None:
    ours = djpt.load_dict(djpt.cornell_box()).bbox()
    theirs = mi.load_dict(mi.cornell_box()).bbox()
    assert isinstance(ours, djpt.ScalarBoundingBox3f)
    assert_same(ours.min, theirs.min)
    assert_same(ours.max, theirs.max)


@pytest.mark.parametrize(
    "build",
    [lambda: djpt.BoundingBox3f("x"), lambda: djpt.BoundingBox3f([1, 2]), lambda: djpt.BoundingSphere3f("x", 1)],
)
def test_refused(build: Any) -> None:
    with pytest.raises(SceneError, match="must be three numbers, found"):
        build()
