"""Each emitter over a floor with two spheres: equal seeds, equal pixels, djpt against Mitsuba."""

from __future__ import annotations

import pytest

from djpt.validation import agreement
from tests.kit.emitters import NAMES, UNLIKE_MITSUBA, entry
from tests.kit.lit_floor import floor_scene
from tests.kit.renders import ours, theirs

pytest.importorskip("mitsuba")


@pytest.mark.sparse(16)
@pytest.mark.parametrize("name", [name for name in NAMES if name not in UNLIKE_MITSUBA])
def test_equal_pixels(name: str) -> None:
    scene = floor_scene({"light": entry(name)})
    share = agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 1e-3).share
    print(f"{name}: {share:.4f}")
    assert share >= 0.95


def test_equal_pixels_under_many_lights() -> None:
    """Lights of all kinds, chosen by their sampling weights."""
    lights = {name: entry(name) for name in ("directional-turned", "area-disk", "spot-bitmap", "projector-colour")}
    scene = floor_scene({**lights, "sky": entry("constant-colour"), "point": entry("point-turned")})
    share = agreement(ours(scene, 8, 1), theirs(scene, 8, 1), 1e-3).share
    print(f"many lights: {share:.4f}")
    assert share >= 0.95
