"""Array types under Mitsuba's names: the same types of Dr.Jit, and usable wherever numbers are."""

from __future__ import annotations

import builtins
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.mitsuba.names import ARRAYS, EXPORTS


def test_types_are_mitsubas(mi: Any) -> None:
    """The same type, or one of the same shape and entries where Mitsuba has a class of its own."""

    def is_mitsubas(name: str) -> bool:
        ours, theirs = getattr(djpt, name), getattr(mi, name)
        kind = theirs.__name__.removeprefix("Scalar")
        return ours is theirs or (
            theirs.__module__ == "mitsuba"
            and kind.startswith(("Vector", "Point", "Normal", "Color"))
            and all(ask(ours) == ask(theirs) for ask in (dr.size_v, dr.type_v, dr.depth_v, dr.is_jit_v, dr.is_diff_v))
        )

    assert [name for name in ARRAYS if not is_mitsubas(name)] == []


def test_none_is_missing(mi: Any) -> None:
    def is_array_type(name: str) -> bool:
        found = getattr(mi, name)
        return isinstance(found, type) and dr.is_array_v(found) and not name.endswith("Ptr")

    missing = [name for name in dir(mi) if is_array_type(name) and not hasattr(djpt, name)]
    assert missing == []
    assert set(ARRAYS) == set(EXPORTS["djpt.mitsuba.arrays"].split()) < set(djpt.__all__)


@pytest.mark.parametrize("name", ["Vector5f", "ScalarPoint3x", "Normal2f"])
def test_unknown_names(name: str) -> None:
    assert not hasattr(djpt, name)


def test_scalars_are_pythons() -> None:
    assert djpt.ScalarFloat is builtins.float and djpt.ScalarUInt32 is int and djpt.ScalarBool is bool
    p = djpt.ScalarPoint3f([1, 2, 2])
    assert dr.norm(p) == 3 and list(p + djpt.ScalarVector3f(1, 0, 0)) == [2, 2, 2] and list(2 * p) == [2, 4, 4]
    assert type(djpt.Point3f(1) + p) is djpt.Point3f
    assert np.array(djpt.ScalarMatrix4f(2)).shape == (4, 4)


def test_scalars_in_scene_descriptions() -> None:
    """Points, colours, numbers and transforms of every kind mean what lists and floats mean."""
    plain = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 40.0,
            "to_world": djpt.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 8, "height": 4},
        },
        "ball": {
            "type": "sphere",
            "center": [0.5, 0, 0],
            "radius": 0.75,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
            "to_world": djpt.ScalarTransform4f().scale(2),
        },
        "light": {"type": "point", "position": [0, 3, 3], "intensity": {"type": "rgb", "value": [5, 6, 7]}},
    }
    size = djpt.ScalarVector2u(8, 4)
    eye = djpt.ScalarPoint3f(0, 0, 5)
    typed = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": djpt.ScalarFloat(40),
            "to_world": djpt.Transform4f().look_at(eye, djpt.ScalarPoint3f(0), djpt.ScalarVector3f(0, 1, 0)),
            "film": {"type": "hdrfilm", "width": size[0], "height": size.y},
        },
        "ball": {
            "type": "sphere",
            "center": djpt.ScalarPoint3f(0.5, 0, 0),
            "radius": djpt.Float(0.75),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": djpt.ScalarColor3f(0.1, 0.2, 0.3)}},
            "to_world": djpt.Transform4f().scale(djpt.ScalarVector3f(2)),
        },
        "light": {
            "type": "point",
            "position": djpt.Point3f(0, 3, 3),
            "intensity": {"type": "rgb", "value": djpt.Color3f(5, 6, 7)},
        },
    }
    images = [np.array(djpt.render(djpt.load_dict(scene), spp=2)) for scene in (plain, typed)]
    assert images[0].max() > 0
    np.testing.assert_allclose(images[1], images[0], rtol=1e-5, atol=1e-6)
