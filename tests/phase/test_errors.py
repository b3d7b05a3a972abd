"""Descriptions of phase functions that are wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, ParameterError, SceneError
from tests.kit.phases import described

HG = {"type": "hg"}


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"type": "hg", "g": 1}, r"hg: 'g' must lie in \(-1, 1\), found 1"),
        ({"type": "hg", "g": "much"}, "hg: 'g' must be a float, found str 'much'"),
        ({"type": "isotropic", "g": 0.5}, "isotropic: unknown key 'g' of phase 'isotropic'"),
        ({"type": "tabphase"}, "tabphase: 'tabphase' needs the key 'values'"),
        ({"type": "tabphase", "values": "1"}, "tabphase: 'values' must be at least two numbers, found 1"),
        ({"type": "tabphase", "values": "1, x"}, "'values' must be numbers separated by commas, found str '1, x'"),
        ({"type": "tabphase", "values": [1, -2]}, "'values' must not be negative, and not all 0"),
        ({"type": "tabphase", "values": "0 0 0"}, "'values' must not be negative, and not all 0"),
        ({"type": "blendphase", "a": HG}, "'blendphase' takes two nested phase functions, found 1"),
        ({"type": "blendphase", "a": HG, "b": HG, "weight": "half"}, "'value' must be a number or a texture"),
        ({"type": "sggx"}, "sggx: 'sggx' needs the key 'S'"),
        ({"type": "sggx", "S": {"type": "constvolume"}}, "'S' must be a volume of six channels.*found a constant"),
        ({"type": "sggx", "S": {"type": "gridvolume", "data": np.ones((2, 2, 2, 3))}}, "six channels.*found 3"),
    ],
)
def test_messages_name_what_is_wrong(description: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(description)


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        ("forward", "g", 1.5, r"must lie in \(-1, 1\), found 1\.5"),
        ("table", "values", [1], "must be at least two numbers"),
        ("table", "values", [1, -1], "must not be negative"),
        ("skewed", "S.data", np.ones((1, 1, 1, 3)), "must keep its 6 channels, found 3"),
    ],
)
def test_edits_are_checked(name: str, key: str, value: Any, message: str) -> None:
    params = djpt.traverse(djpt.load_dict(described(name)))
    with pytest.raises(ParameterError, match=message):
        params[key] = value
        params.update()


def test_matrices_have_six_entries() -> None:
    with pytest.raises(ArgumentError, match="takes six numbers or two arrays of three, found 5"):
        djpt.SGGXPhaseFunctionParams([1, 2, 3, 4, 5])
