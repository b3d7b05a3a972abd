"""The gradient checker: right gradients pass, planted faults are caught."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.cli.gradcheck import SIDE as SIDE_OF_HELP
from djpt.errors import ParameterError
from djpt.scenes.overrides import override, reduced
from djpt.validation.gradcheck import check_gradient
from djpt.validation.gradcheck.check import SIDE, judged
from djpt.validation.statistics import limit_of
from tests.kit.commands import run
from tests.kit.faults import FAULTS

KEY = "red.albedo.value"


def box(fault: str = "", **options: Any) -> dict[str, Any]:
    """The Cornell box with a user's paint on its red wall."""
    scene = override(djpt.cornell_box(), width=12, **options)
    scene["red"] = {"type": "faulty_diffuse", "albedo": scene["red"]["reflectance"], "fault": fault}
    return scene


def check(fault: str, **options: Any) -> Any:
    return check_gradient(box(fault), KEY, **{"spp": 192, "seeds": 4, "most_seeds": 8, **options})


@pytest.mark.sparse(10)
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_are_caught(fault: str) -> None:
    result = check(fault)
    assert not result.passed, result
    # Forward and reverse mode agree on the fault: only differences know better.
    assert all("differences" in verdict.what for verdict in result.failures), result


def test_a_right_gradient_passes() -> None:
    result = check("")
    assert result.passed, result
    assert result.resolution < 0.02
    assert any("Mitsuba" in note for note in result.notes)
    assert np.all(result.gradient > 0)


@pytest.mark.slow
def test_false_alarms_are_rare() -> None:
    """Of 40 checks of right gradients none fails: more than 2 in 100 false alarms would show in every second run."""
    failed = [seed for seed in range(40) if not check("", seed=seed, spp=16, seeds=6, most_seeds=12).passed]
    assert not failed


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_are_caught_by_the_defaults(fault: str) -> None:
    scene = djpt.cornell_box()
    scene["red"] = box(fault)["red"]
    result = check_gradient(scene, KEY)
    assert not result.passed, result


@pytest.mark.slow
def test_large_pictures_are_checked_small() -> None:
    """The command on the page of commands takes seconds: pictures of 256 x 256 are reduced to 64 x 64."""
    calls: list[tuple[int, int]] = []
    options: dict[str, Any] = {"spp": 4, "seeds": 3, "most_seeds": 4, "precision": 0.0, "mitsuba": False}
    result = check_gradient("cornell_box", "red.reflectance.value", progress=lambda *now: calls.append(now), **options)
    assert result.derivative.shape == (SIDE, SIDE, 3)
    # Each seed: reverse mode, and three times forward mode and four images of differences. The bar moves within seeds.
    assert calls[0] == (0, 3 * 16) and calls[-1] == (4 * 16, 4 * 16)
    assert max(b - a for (a, _), (b, _) in itertools.pairwise(calls)) <= 4
    options["most_seeds"] = 3
    assert check_gradient(box(), KEY, width=5, **options).derivative.shape == (5, 5, 3)


def test_reduced_films() -> None:
    scene = {**djpt.cornell_box(), "other": {"type": "radiancemeter", "film": {"type": "hdrfilm", "width": 500}}}
    wide = override(scene, width=200, height=100)
    assert sizes(reduced(wide, 64)) == [(64, 32), (500, None)]
    tall = override(scene, width=100, height=200)
    assert sizes(reduced(tall, 64)) == [(32, 64), (500, None)]
    assert reduced(tall, 200) == tall
    scene["sensor"]["film"]["crop_width"] = 3
    assert reduced(scene, 64) == scene, "a crop window says which pixels are meant"
    scene["sensor"] = {"type": "perspective"}
    assert sizes(reduced(scene, 64)) == [(64, 48), (500, None)]


def sizes(scene: dict[str, Any]) -> list[tuple[int, int | None]]:
    return [(scene[key]["film"]["width"], scene[key]["film"].get("height")) for key in ("sensor", "other")]


@pytest.mark.slow
@pytest.mark.parametrize("key", ["white.reflectance.value", "light.emitter.radiance.value"])
def test_against_mitsuba(key: str) -> None:
    pytest.importorskip("mitsuba")
    result = check_gradient("cornell_box", key, width=16, mitsuba=True)
    assert result.passed, result
    assert sum("Mitsuba" in verdict.what for verdict in result.verdicts) == 3


@pytest.mark.slow
def test_ends_of_ranges() -> None:
    """At 0 and 1 differences are one-sided, and Mitsuba isn't asked where it is wrong."""
    scene = override(djpt.cornell_box(), width=12)
    scene["red"]["reflectance"] = {"type": "rgb", "value": [0.0, 1.0, 0.5]}
    result = check_gradient(scene, "red.reflectance.value", seeds=4, most_seeds=8)
    assert result.passed, result
    assert any("divides by the differentiated value" in note for note in result.notes)


@pytest.mark.slow
def test_textures_at_both_ends_of_their_range() -> None:
    """A black texel and a white one: no direction of random signs keeps both in the range."""
    scene = override(djpt.cornell_box(), width=8)
    texels = np.full((2, 2, 3), 0.5, np.float32)
    texels[0, 0], texels[1, 1] = 0, 1
    scene["white"]["reflectance"] = {"type": "bitmap", "data": texels, "raw": True}
    options: dict[str, Any] = {"spp": 16, "seeds": 3, "most_seeds": 3, "samples": 2, "mitsuba": False}
    result = check_gradient(scene, "white.reflectance.data", **options)
    assert result.passed, result
    assert [verdict.what for verdict in result.verdicts][:2] == [
        "all entries, forward mode",
        "all entries, differences",
    ]


@pytest.mark.slow
def test_textures_are_checked_by_directions_and_texels() -> None:
    scene = override(djpt.cornell_box(), width=16)
    texels = np.random.default_rng(0).uniform(0.2, 0.8, (4, 4, 3)).astype(np.float32)
    scene["white"]["reflectance"] = {"type": "bitmap", "data": texels, "raw": True}
    result = check_gradient(scene, "white.reflectance.data", seeds=4, most_seeds=16, mitsuba=False)
    assert result.passed, result
    names = {verdict.what.partition(",")[0] for verdict in result.verdicts}
    assert {"all entries", "random signs 1", "random signs 2"} < names
    assert sum(name.startswith("entry ") for name in names) == 4


@pytest.mark.sparse(2)
@pytest.mark.parametrize("data", ["white and black", "black"])
@pytest.mark.slow
def test_texels_at_the_ends_of_their_range(data: str) -> None:
    """Entries at an end change inwards only: a black texel, of three zeros, can't follow random signs."""
    scene = override(djpt.cornell_box(), width=8)
    texels = np.full((4, 4, 3), 0.5, np.float32)
    texels[1, 1] = 0
    texels[2, 2] = 1 if "white" in data else 0.5
    scene["white"]["reflectance"] = {"type": "bitmap", "data": texels, "raw": True}
    options: dict[str, Any] = {"spp": 16, "seeds": 3, "most_seeds": 3, "samples": 2, "mitsuba": False}
    result = check_gradient(scene, "white.reflectance.data", **options)
    assert result.passed, result
    assert len(result.verdicts) >= 2 * 4


def test_verdicts() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(size=20)
    ours, limit = 1 + noise, limit_of(1e-3, 1)
    assert judged("same", ours, 1.001 + noise, limit).passed  # within rounding
    assert not judged("other", ours, 1.1 + noise, limit).passed
    assert judged("other", ours, 1.1 + noise, limit, 0.2).passed
    assert judged("independent", ours, 1 + rng.normal(size=20), limit, paired=False).passed
    assert not judged("independent", ours, 9 + rng.normal(size=20), limit, paired=False).passed
    assert not judged("not a number", np.full(4, np.nan), np.ones(4), limit).passed
    assert judged("without noise", np.ones(4), np.ones(4), limit).passed
    assert not judged("without noise", np.ones(4), np.full(4, 2.0), limit).passed


def test_what_cant_be_checked() -> None:
    with pytest.raises(ParameterError, match="unknown parameter"):
        check_gradient(box(), "red.albedo.colour")
    with pytest.raises(ParameterError, match="has no derivatives"):
        check_gradient(box(), "sensor.near_clip")
    with pytest.raises(djpt.validation.ComparisonError, match="Mitsuba can't load the scene"):
        check_gradient(box(), KEY, mitsuba=True)


@pytest.mark.slow
def test_the_command_line(tmp_path: Path) -> None:
    assert SIDE_OF_HELP == SIDE
    small = ("--width", "8", "--spp", "16", "--seeds", "3", "--most-seeds", "3", "--no-mitsuba")
    picture = tmp_path / "red.png"
    code, out, err = run("gradcheck", "cornell_box", "red.reflectance.value", *small, "-o", str(picture))
    assert code == 0, err
    assert "1 of 1 gradients are right" in out
    assert djpt.read(picture).shape[2] == 3
    code, out, _ = run("gradcheck", "cornell_box", "--json", *small)
    assert json.loads(out)["unchecked"] == []
    checks = json.loads(out)["checks"]
    assert {each["key"] for each in checks} == {
        "white.reflectance.value",
        "green.reflectance.value",
        "red.reflectance.value",
        "light.emitter.radiance.value",
    }
    assert code == (not all(each["passed"] for each in checks))
    code, _, err = run("gradcheck", "cornell_box", "red.reflectance")
    assert code == 2 and "red.reflectance.value" in err


@pytest.mark.parametrize("key", ["light.to_world", "lamp.position"])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_motions_of_lights(key: str) -> None:
    """On a floor without shadows, where there is little noise."""
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    place = djpt.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    scene = {
        "type": "scene",
        "integrator": {"type": "direct_projective", "sppi": 0},
        "sensor": {"type": "perspective", "fov": 40, "to_world": place, "film": film},
        "floor": {"type": "rectangle", "to_world": djpt.ScalarTransform4f().scale(3)},
        "light": {"type": "spot", "to_world": place, "cutoff_angle": 25.0, "intensity": 50.0},
        "lamp": {"type": "point", "position": [1, 0, 2]},
    }
    result = check_gradient(scene, key, spp=16, seeds=4, most_seeds=4)
    assert result.passed, result
    assert result.gradient.size == (3 if key.endswith("position") else 6) and np.abs(result.gradient).max() > 0.002


@pytest.mark.parametrize("key", ["sensor.to_world", "sensor.x_fov", "ball.to_world"])
@pytest.mark.sparse(3)
@pytest.mark.slow
def test_motions(key: str) -> None:
    """Shapes and cameras are moved as a whole; noise of silhouettes hides small errors."""
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    place = djpt.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    scene = {
        "type": "scene",
        "integrator": {"type": "direct_projective", "sppi": 0},
        "sensor": {"type": "perspective", "fov": 40, "to_world": place, "film": film},
        "ball": {"type": "sphere", "emitter": {"type": "area"}},
    }
    result = check_gradient(scene, key, spp=64, seeds=4, most_seeds=4)
    assert result.passed, result
    assert result.gradient.size == (1 if key.endswith("fov") else 6) and np.abs(result.gradient).max() > 0.005
    assert "not compared with Mitsuba" in result.notes[0]
