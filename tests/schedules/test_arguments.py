"""Numbers that don't fit into what kernels count with, and arguments of other types."""

from __future__ import annotations

from typing import Any

import pytest

import djpt


@pytest.fixture(scope="module")
def scene() -> Any:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=4, height=4)
    return djpt.load_dict(description)


@pytest.mark.parametrize("key", ["max_depth", "rr_depth"])
@pytest.mark.parametrize("value", [2**32, 2**70], ids=repr)
def test_depths_of_more_than_32_bits(key: str, value: int) -> None:
    with pytest.raises(djpt.SceneError, match=f"'{key}' must fit into 32 bits, found int {value}"):
        djpt.load_dict({"type": "path", key: value})


def test_sample_counts_that_are_rounded_up_to_too_many() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=1, height=1)
    description["sensor"]["sampler"] = {"type": "stratified", "sample_count": 2**32 - 1}
    with pytest.raises(djpt.RenderError, match=r"more than 2\^32 samples"):
        djpt.render(djpt.load_dict(description))


@pytest.mark.parametrize("arguments", [{"spp": 2**32}, {"progress": 5}, {"integrator": djpt.UInt32([1, 2])}], ids=str)
def test_arguments_that_nothing_can_be_done_with(scene: Any, arguments: dict[str, Any]) -> None:
    with pytest.raises(djpt.RenderError, match=next(iter(arguments))):
        djpt.render(scene, **{"spp": 1, **arguments})
