"""Groups of shapes and their instances: names, extents and errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import SceneError
from djpt.geometry.axes import AxisPool
from djpt.shapes import Instance, ShapeGroup
from djpt.transforms import ScalarTransform4f as T

GROUP: dict[str, Any] = {
    "type": "shapegroup",
    "a": {"type": "cube", "to_world": T().translate([1, 0, 0])},
    "b": {"type": "sphere", "center": [0, 3, 0]},
}


def test_an_instance_reaches_as_far_as_its_moved_group() -> None:
    turned = T().translate([5, 0, 1]).rotate([0, 0, 1], 90).scale([2, 1, 1])
    instance = djpt.load_dict(
        {"type": "instance", "to_world": turned, "group": {"type": "shapegroup", "a": GROUP["a"]}}
    )
    assert isinstance(instance, Instance)
    assert isinstance(instance.group, ShapeGroup)
    instance.group.place(AxisPool())
    # x in [0, 2] becomes y in [0, 4]; y in [-1, 1] becomes x in [4, 6].
    extents = [instance.interval(axis) for axis in np.eye(3)]
    np.testing.assert_allclose(extents, [(4, 6), (0, 4), (0, 2)], atol=1e-6)
    group = djpt.load_dict(GROUP)
    group.place(AxisPool())
    assert group.interval(np.array([0.0, 1.0, 0.0])) == pytest.approx((-1, 4))


def test_parameters_have_the_names_of_mitsuba() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    names = [key for key, _ in mi.traverse(mi.load_dict({**GROUP, "a": {"type": "cube"}})).items()]
    # Mitsuba shows the BSDF that a shape without one gets.
    assert list(djpt.traverse(djpt.load_dict(GROUP))) == [n for n in names if ".bsdf." not in n]
    group = djpt.load_dict(GROUP)
    group.place(AxisPool())
    instance = djpt.load_dict({"type": "instance", "group": group})
    params = djpt.traverse(instance)
    assert list(params) == ["to_world"]
    params["to_world"] = T().translate([0, 0, 7])
    params.update()
    assert instance.interval(np.array([0.0, 0.0, 1.0])) == pytest.approx((6, 8))


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"type": "shapegroup"}, "shapegroup: the 'shapegroup' is empty"),
        ({"type": "shapegroup", "g": GROUP}, "'g' is itself a group or an instance"),
        ({"type": "shapegroup", "i": {"type": "instance", "g": GROUP}}, "'i' is itself a group or an instance"),
        (
            {"type": "shapegroup", "lamp": {"type": "sphere", "emitter": {"type": "area"}}},
            "'lamp' has an emitter; what is instanced can't emit light",
        ),
        ({"type": "shapegroup", "x": GROUP["a"], "to_world": T()}, "unknown key 'to_world' of shape 'shapegroup'"),
        ({"type": "instance"}, "instance: an 'instance' needs one 'shapegroup' or a reference to one, found: none"),
        ({"type": "instance", "s": {"type": "sphere"}}, r"found: 's' \(Sphere\)"),
        ({"type": "instance", "g": GROUP, "h": GROUP}, r"found: 'g' \(ShapeGroup\), 'h' \(ShapeGroup\)"),
        ({"type": "instance", "g": GROUP, "bsdf": {"type": "diffuse"}}, "unknown key 'bsdf'"),
        ({"type": "instance", "g": GROUP, "to_world": T().scale(0).matrix}, "'to_world' must be invertible"),
    ],
)
def test_what_cannot_be_instanced_is_explained(node: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(node)
