"""Built-in scenes: Mitsuba's Cornell box entry by entry, variants that differ where they should."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f
from djpt.scenes import SCENES, cornell_box, cornell_box_boxfilter, cornell_box_spheres, furnace


def assert_same(ours: Any, theirs: Any, where: str) -> None:
    """Equal entries in equal order; transforms to float32 rounding."""
    if isinstance(theirs, Mapping):
        assert list(ours) == list(theirs), where
        for key in theirs:
            assert_same(ours[key], theirs[key], f"{where}.{key}")
    elif isinstance(ours, ScalarTransform4f):
        np.testing.assert_allclose(ours.matrix, np.array(theirs.matrix), atol=2e-7, err_msg=where)
    else:
        assert type(ours) is type(theirs) and ours == theirs, where


def test_cornell_box_is_mitsubas() -> None:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    assert_same(cornell_box(), mitsuba.cornell_box(), "scene")


@pytest.mark.parametrize("name", SCENES)
def test_scenes_load_and_say_what_they_are(name: str) -> None:
    make = SCENES[name]
    assert make.__name__ == name and make.__doc__
    first, second = ({key: node for key, node in make().items() if not isinstance(node, djpt.Mesh)} for _ in range(2))
    assert first == second and first is not second
    scene = djpt.load_dict(make())
    assert scene.kind == "scene" and scene.sensors() and scene.emitters() and scene.integrator()


def test_scenes_are_independent() -> None:
    first = cornell_box()
    first["sensor"]["film"]["width"] = 7
    first["white"]["reflectance"]["value"][0] = 0
    assert cornell_box()["sensor"]["film"]["width"] == 256
    assert cornell_box()["white"]["reflectance"]["value"][0] == 0.885809


def test_boxfilter_differs_in_the_filter_only() -> None:
    scene = cornell_box_boxfilter()
    assert scene["sensor"]["film"]["rfilter"] == {"type": "box"}
    scene["sensor"]["film"]["rfilter"] = {"type": "gaussian"}
    assert scene == cornell_box()


def test_spheres_stand_on_the_floor_inside_the_room() -> None:
    spheres = [shape for shape in djpt.load_dict(cornell_box_spheres()).shapes() if shape.id().endswith("sphere")]
    assert len(spheres) == 2
    for sphere in spheres:
        center, radius = sphere.to_world.translation(), np.linalg.norm(sphere.to_world.matrix[:3, 0])
        assert center[1] - radius == pytest.approx(-1)
        assert (np.abs(center) + radius <= 1 + 1e-12).all()
    (a, b) = (s.to_world for s in spheres)
    apart = np.linalg.norm(a.translation() - b.translation())
    assert apart > np.linalg.norm(a.matrix[:3, 0]) + np.linalg.norm(b.matrix[:3, 0])


@pytest.mark.parametrize(("reflectance", "radiance", "depth"), [(0.5, 1.0, 8), (0.8, 3.0, 4), (0.0, 2.0, 2)])
def test_furnace_glows_as_computed(reflectance: float, radiance: float, depth: int) -> None:
    scene = furnace(reflectance, radiance)
    scene["integrator"] = {"type": "path", "max_depth": depth, "rr_depth": 100}
    scene["sensor"]["film"].update(width=16, height=16)
    image = np.array(djpt.render(djpt.load_dict(scene), spp=64))
    expected = radiance * sum(reflectance**k for k in range(depth))
    assert image.shape == (16, 16, 3)
    assert image.mean() == pytest.approx(expected, rel=0.01)


def test_furnace_is_closed() -> None:
    """With black walls every camera ray sees a lamp: no noise, no gap."""
    scene = furnace(0.0, 2.0)
    scene["sensor"]["film"].update(width=32, height=32)
    image = np.array(djpt.render(djpt.load_dict(scene), spp=16))
    np.testing.assert_allclose(image, 2.0, rtol=1e-6)


def test_commands_know_all_scenes() -> None:
    assert tuple(sorted(SCENES)) == djpt.scenes.NAMES
