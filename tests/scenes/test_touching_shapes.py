"""Shapes that touch, and the bodies that derivatives take them for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.dispatch.family import NONE
from djpt.integrators.projective.self_views import with_bodies
from djpt.jit.types import Bool, UInt32
from djpt.scene import touching_shapes
from djpt.scene.touching_shapes import in_touch
from djpt.shapes.silhouettes.foreground import nothing_at
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

LAMP = {"type": "area", "radiance": 1.0}


def ball(x: float, **more: Any) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, 0, 1], "radius": 1.0, **more}


def floor(size: float, **more: Any) -> dict[str, Any]:
    return {"type": "rectangle", "to_world": T().scale(size), **more}


def shapes(**nodes: Any) -> list[Any]:
    """The shapes of a scene, in the order of their names here."""
    scene = djpt.load_dict({"type": "scene", **nodes}, optimize=False)
    found = {shape.id(): shape for shape in scene.shapes()}
    return [found[name] for name in nodes]


def test_shapes_are_in_touch_by_way_of_others() -> None:
    assert in_touch(shapes(a=ball(-4), b=ball(4), c=ball(20))) == [0, 1, 2]
    assert in_touch(shapes(a=ball(-4), b=ball(4), c=ball(20), d=floor(9))) == [0, 0, 2, 0]
    assert in_touch(shapes(a=ball(20), b=ball(-4), c=ball(-2))) == [0, 1, 1]
    assert in_touch([]) == []


def test_of_very_many_shapes_all_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(touching_shapes, "MOST_SHAPES", 2)
    assert in_touch(shapes(a=ball(-4), b=ball(4), c=ball(20))) == [0, 0, 0]


def test_lamps_and_lone_flat_shapes_belong_to_no_body() -> None:
    lone = floor(1, emitter=LAMP)
    above = {"type": "rectangle", "to_world": T().translate([0, 0, 50])}
    scene = djpt.load_dict(
        {"type": "scene", "a": ball(0), "b": floor(9), "c": lone, "d": above, "e": ball(30)}, optimize=False
    )
    names = [shape.id() for shape in scene.geometry.contents.shapes]
    bodies = with_bodies(scene, everywhere=True).bodies
    found = dict(zip(names, (int(number) for number in np.array(bodies.of_shape)), strict=True))
    assert found["a"] == found["b"] != NONE and found["c"] == found["d"] == NONE
    assert found["e"] not in (NONE, found["a"])
    assert {names[number] for number in bodies.moving} == {"a", "b", "e"}
    assert with_bodies(scene, everywhere=False).bodies.moving == ()


@pytest.mark.parametrize(("height", "free"), [(0.0, False), (-5e-4, False), (0.1, True)])
def test_rims_that_stand_are_no_silhouettes(height: float, free: bool) -> None:
    tube = {"type": "cylinder", "p0": [0, 0, height], "p1": [0, 0, 2], "radius": 1.0}
    scene = djpt.load_dict({"type": "scene", "tube": tube, "floor": floor(6)}, optimize=False)
    shape = next(shape for shape in scene.shapes() if shape.id() == "tube")
    rim = shape.silhouette().sample_precomputed(
        djpt.Point3f(0, -8, 4), UInt32(int(djpt.DiscontinuityFlags.PerimeterType)), djpt.Float([0.1, 0.3]), Bool(True)
    )
    assert isinstance(rim, SilhouetteSample3f) and np.allclose(np.array(rim.p)[2], height, atol=1e-5)
    assert np.array(nothing_at(scene, rim, Bool(True))).tolist() == [free, free]
