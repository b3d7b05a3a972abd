"""Which emitters and sensors a scene has, whether they stand in it, in a shape, or in it for a shape to refer to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import RenderError, SceneError
from tests.kit.renders import ours, theirs

pytestmark = pytest.mark.narrow

LIGHT = {"type": "ref", "id": "light"}
AREA = {"type": "area", "radiance": {"type": "rgb", "value": [3.0, 2.0, 1.0]}}
METER = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}}}
VIEW = {
    "type": "perspective",
    "fov": 60,
    "to_world": T().look_at(origin=[0, -4, 2], target=[0, 0, 1], up=[0, 0, 1]),
    "film": {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}},
}


def lamp(**nested: Any) -> dict[str, Any]:
    return {"type": "sphere", "radius": 0.3, "center": [0, 0, 2], **nested}


def point(x: float) -> dict[str, Any]:
    return {"type": "point", "position": [x, 0, 3], "intensity": 1.0}


def scene(**nodes: Any) -> dict[str, Any]:
    floor = {"type": "rectangle", "to_world": T().scale(3)}
    return {"type": "scene", "integrator": {"type": "path", "max_depth": 4}, "sensor": VIEW, "floor": floor, **nodes}


# What the scene holds besides, and the emitters in the order in which Mitsuba 3.9.1 numbers them.
ORDERS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "light before its shape": ({"light": AREA, "p": point(1), "lamp": lamp(e=LIGHT)}, ["p", "light"]),
    "shape before its light": ({"lamp": lamp(e=LIGHT), "p": point(1), "light": AREA}, ["light", "p"]),
    "light last, shape in the middle": (
        {"p": point(1), "lamp": lamp(e=LIGHT), "q": point(-1), "light": AREA},
        ["p", "light", "q"],
    ),
    "light in the middle, shape last": (
        {"p": point(1), "light": AREA, "q": point(-1), "lamp": lamp(e=LIGHT)},
        ["p", "q", "light"],
    ),
    "light referred to by the scene too": ({"light": AREA, "again": LIGHT, "lamp": lamp(e=LIGHT)}, ["light"]),
    "a point light, twice": ({"p": point(1), "again": {"type": "ref", "id": "p"}}, ["p", "p"]),
    "a light without a shape": ({"p": point(1), "light": AREA}, ["p"]),
}


@pytest.mark.sparse(4)
@pytest.mark.filterwarnings("ignore:light. no shape refers to this emitter")
@pytest.mark.parametrize("name", ORDERS)
def test_emitters_are_numbered_as_in_mitsuba(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    nodes, order = ORDERS[name]
    description = scene(**nodes)
    mine = djpt.load_dict(description)
    reference = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False)
    assert [e.id() for e in mine.emitters()] == [e.id() for e in reference.emitters()] == order
    light = [key for key in djpt.traverse(mine) if "radiance" in key or "intensity" in key]
    assert light == [key for key in mi.traverse(reference).keys() if "radiance" in key or "intensity" in key]  # noqa: SIM118
    image, expected = ours(description, 16), theirs(description, 16)
    assert expected.mean() > 0.004
    np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-5)


def test_a_light_by_reference_gives_the_same_bits_as_a_nested_one() -> None:
    nested = ours(scene(p=point(1), lamp=lamp(emitter=AREA)))
    before = ours(scene(light=AREA, p=point(1), lamp=lamp(e=LIGHT)))
    after = ours(scene(p=point(1), lamp=lamp(e=LIGHT), light=AREA))
    np.testing.assert_array_equal(before, nested)
    np.testing.assert_array_equal(after, nested)


def test_a_light_without_a_shape_is_told_of() -> None:
    with pytest.warns(UserWarning, match="light: no shape refers to this emitter, so it emits no light"):
        loaded = djpt.load_dict(scene(light=AREA))
    assert loaded.emitters() == []
    assert "light.radiance.value" in djpt.traverse(loaded)
    with pytest.raises(RenderError, match="the scene has no emitter"):
        djpt.render(loaded, spp=1)


REFUSED = {
    "two shapes": ({"light": AREA, "a": lamp(e=LIGHT), "b": lamp(e=LIGHT)}, "b: its emitter already belongs to 'a'"),
    # Mitsuba counts its light twice when it samples lights, and once when a path meets it.
    "shape twice": (
        {"a": lamp(e=AREA), "again": {"type": "ref", "id": "a"}},
        "a: a shape that emits light can't appear in the scene twice",
    ),
    "one meter in two shapes": (
        {"meter": METER, **{key: lamp(s={"type": "ref", "id": "meter"}) for key in "ab"}},
        "b: its sensor already belongs to 'a'",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_belongs_nowhere_clearly_is_refused(name: str) -> None:
    nodes, message = REFUSED[name]
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(scene(**nodes))


@pytest.mark.parametrize("first", [True, False])
def test_sensors_are_numbered_as_in_mitsuba(first: bool) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    nodes = {"meter": METER, "ball": lamp(s={"type": "ref", "id": "meter"}), "sky": {"type": "constant"}}
    if not first:
        nodes = dict(reversed(nodes.items()))
    description = scene(**nodes)
    mine = djpt.load_dict(description)
    reference = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False)
    assert [s.id() for s in mine.sensors()] == [s.id() for s in reference.sensors()] == ["sensor", "meter", "meter"]
    for number in (1, 2):
        expected = np.array(mi.render(reference, sensor=number, spp=16, seed=1))
        assert expected.mean() > 2
        found = np.array(djpt.render(mine, sensor=number, spp=16, seed=1))
        np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_meter_without_a_shape_leaves_other_sensors_alone() -> None:
    loaded = djpt.load_dict(scene(meter=METER, p=point(1)))
    assert np.array(djpt.render(loaded, spp=4)).mean() > 0
    with pytest.raises(RenderError, match="'meter' must be nested in a shape of the scene to be rendered"):
        djpt.render(loaded, sensor=1, spp=4)
