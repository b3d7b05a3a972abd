"""Anything is compared with anything: scenes, integrators, schedules, images, references, functions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import FileError, SceneError
from djpt.images.image import read_metadata
from djpt.scenes.overrides import override
from djpt.validation import (
    ComparisonError,
    assert_matches,
    compare,
    read_reference,
    store_reference,
)
from djpt.validation.comparands import as_renderer
from tests.kit.commands import run
from tests.kit.processes import run_python

pytest.importorskip("scipy")


def scene(factor: float = 1.0) -> dict[str, Any]:
    """A floor below a sky: quick, and without much noise."""
    description = override(djpt.scenes.stage({"sky": {"type": "constant"}}, size=16), rfilter="box")
    return {**description, "sky": {"type": "constant", "radiance": factor}}


def noise(spp: int, seed: int, factor: float = 1.0) -> np.ndarray:
    return factor * np.random.default_rng(seed).gamma(spp, 1 / spp, (40, 33, 3)).astype(np.float32)


def brighter(spp: int, seed: int) -> np.ndarray:
    return noise(spp, seed, 1.05)


# ---------------------------------------------------------------- what is compared


def test_integrator_against_integrator() -> None:
    result = compare(scene(), spp=32, integrator={"type": "path", "max_depth": 3}, integrator_b="path_nee")
    assert result.titles == ("djpt, path", "djpt, path_nee")
    assert result.passed, str(result)
    assert result.facts[1]["description"]["integrator"]["type"] == "path_nee"
    assert not compare(scene(), spp=64, integrator="path", integrator_b={"type": "path", "max_depth": 1}).passed


def test_schedule_against_schedule() -> None:
    result = compare(scene(), spp=16, schedule="flat", schedule_b="wave", same_seed=0.999)
    assert result.titles == ("djpt, flat", "djpt, wave")
    assert result.passed, str(result)


def test_scene_against_scene_and_loaded_ones() -> None:
    assert compare(scene(), spp=16, against=scene()).passed
    assert not compare(scene(), spp=64, against=scene(1.1)).passed
    result = compare(scene(), spp=16, against=djpt.load_dict(scene()))
    assert result.passed and result.titles == ("A, djpt", "B, djpt")


def test_a_scene_that_mitsuba_has_loaded(mi: Any) -> None:
    loaded = mi.load_dict(djpt.validation.to_mitsuba(scene()))
    result = compare(loaded, spp=32, against=scene())
    assert result.titles == ("Mitsuba", "djpt") and result.passed, str(result)


def test_image_against_image(tmp_path: Path) -> None:
    first, second = noise(64, 0), noise(64, 1)
    djpt.write(tmp_path / "a.exr", first)
    result = compare(str(tmp_path / "a.exr"), against=second)
    assert result.titles == ("a.exr", "image")
    assert not result.tests and result.checks == 0 and "without thresholds" in str(result)
    assert math.isnan(result.noise_rmse) and "nan" not in str(result)
    assert compare(first, against=first, limits={"rmse": 0, "psnr": 90, "ssim": 0.999}, same_seed=1).passed
    failed = compare(first, against=second, limits={"rmse": 1e-3, "psnr": 90, "ssim": 0.999, "mae": 1e-3})
    assert [line.split()[0].rstrip(",") for line in failed.failures] == ["RMSE", "PSNR", "SSIM", "MAE"]
    with pytest.raises(ComparisonError, match="nothing to assert"):
        assert_matches(first, against=first)


def test_functions() -> None:
    assert compare(noise, spp=64, against=noise).passed
    failed = compare(brighter, spp=256, against=noise)
    assert not failed.passed and failed.titles == ("brighter", "noise")
    exact = np.ones((40, 33, 3), np.float32)
    assert compare(noise, spp=64, against=lambda: exact).passed, "a closed form has no noise"
    assert not compare(brighter, spp=256, against=lambda: exact).passed


def test_arguments_of_functions() -> None:
    seen: list[Any] = []

    def told(*arguments: Any) -> np.ndarray:
        seen.append(arguments)
        return np.ones((2, 2))

    as_renderer(lambda spp, seed: told(spp, seed))(3, 4)
    as_renderer(lambda seed, spp=1: told(spp, seed))(3, 4)
    as_renderer(lambda number: told(number))(3, 4)
    as_renderer(lambda n, k: told(n, k))(3, 4)
    as_renderer(lambda **options: told(options["spp"], options["seed"]))(3, 4)
    as_renderer(lambda: told())(3, 4)
    assert seen == [(3, 4), (3, 4), (4,), (3, 4), (3, 4), ()]
    assert as_renderer(lambda: np.ones((2, 5)))(1, 0).shape == (2, 5, 1)


def test_what_cannot_be_compared(tmp_path: Path) -> None:
    image = noise(4, 0)
    with pytest.raises(ComparisonError, match="`against`"):
        compare(image)
    with pytest.raises(ComparisonError, match="'z' needs the noise of both"):
        compare(image, against=image, limits={"z": 4})
    with pytest.raises(ComparisonError, match="can be given another integrator, not a ndarray"):
        compare(image, against=image, integrator="path")
    with pytest.raises(ComparisonError, match="need one shape"):
        compare(image, against=image[1:])
    with pytest.raises(ComparisonError, match="bytes"):
        compare(image.astype(np.uint8), against=image)
    with pytest.raises(SceneError, match="a function that renders, found a int"):
        compare(image, against=3)
    with pytest.raises(FileError, match="missing"):
        compare(image, against=tmp_path / "missing.exr")


# ---------------------------------------------------------------- thresholds of the tests


def test_z_replaces_the_limit_of_the_mean() -> None:
    result = compare(noise, spp=64, against=noise, limits={"z": 1e-9})
    assert [test.name for test in result.tests if not test.passed] == ["image mean"]
    assert compare(brighter, spp=256, against=noise, limits={"z": 1e9}).tests[0].passed
    without = compare(brighter, spp=256, against=noise, limits={"bias": 0.1}, tests=False)
    assert without.passed and not without.tests
    assert len(compare(noise, spp=64, against=noise, limits={"z": 4}, tests=False).tests) == 1


# ---------------------------------------------------------------- references


def test_a_reference_keeps_what_the_tests_need(tmp_path: Path) -> None:
    target = tmp_path / "sky.exr"
    stored = store_reference(target, scene(), spp=32)
    found = read_reference(target)
    assert (found.batch_spp, found.seeds, found.independent_pixels) == (4, stored.seeds, True)
    for name in ("mean", "cells"):
        np.testing.assert_allclose(getattr(found.batches, name), getattr(stored.batches, name), rtol=1e-6)
    np.testing.assert_allclose(found.batches.pixels().variance, stored.batches.pixels().variance, rtol=1e-5, atol=1e-12)
    assert found.facts["versions"]["djpt"] == djpt.__version__
    assert found.facts["description"]["sky"] == {"type": "constant", "radiance": 1.0}
    assert djpt.read(target).shape == (16, 16, 6)

    result = compare(scene(), spp=32, against=target, same_seed=1.0)
    assert result.passed and result.tests and result.titles == ("djpt", "sky.exr"), str(result)
    assert result.same_seed is not None and result.same_seed.worst < 1e-5, "rendered again with the same seeds"
    assert not compare(scene(1.1), spp=32, against=found).passed
    assert compare(target, against=found, same_seed=1).rmse < 1e-9


def test_references_of_functions(tmp_path: Path) -> None:
    target = tmp_path / "noise.exr"
    store_reference(target, noise, spp=64)
    assert compare(noise, spp=64, against=target).passed
    assert not compare(brighter, spp=256, against=target).passed


def test_wrong_references(tmp_path: Path) -> None:
    with pytest.raises(ComparisonError, match="an image has no batches"):
        store_reference(tmp_path / "a.exr", noise(4, 0))
    with pytest.raises(FileError, match="is an exr"):
        store_reference(tmp_path / "a.png", noise, spp=8)
    djpt.write(tmp_path / "plain.exr", noise(4, 0))
    with pytest.raises(FileError, match="an image without its noise"):
        read_reference(tmp_path / "plain.exr")
    store_reference(tmp_path / "good.exr", noise, spp=8)
    metadata = read_metadata(tmp_path / "good.exr")
    pixels = np.array(djpt.read(tmp_path / "good.exr"))
    djpt.write(tmp_path / "cut.exr", pixels[:9], metadata=metadata)
    with pytest.raises(FileError, match="damaged"):
        read_reference(tmp_path / "cut.exr")
    djpt.write(tmp_path / "new.exr", pixels, metadata={**metadata, "djpt.reference": "9"})
    with pytest.raises(FileError, match="of form 9"):
        read_reference(tmp_path / "new.exr")


# ---------------------------------------------------------------- the command


def test_the_command_compares_images(tmp_path: Path) -> None:
    first, second = tmp_path / "a.exr", tmp_path / "b.exr"
    djpt.write(first, noise(64, 0))
    djpt.write(second, noise(64, 1))
    code, out, _ = run("compare", str(first), str(second), "--psnr", "5", "--json")
    found = json.loads(out)
    assert code == 0 and found["passed"] and found["limits"] == {"psnr": 5} and found["tests"] == []
    assert found["measures"]["mae"] > 0 and "flip" not in found["measures"]
    code, out, _ = run("compare", str(first), str(second), "--psnr", "90", "--no-picture")
    assert code == 1 and "FAILED" in out
    code, _, err = run("compare", str(first), str(tmp_path / "c.exr"), "--no-picture")
    assert code == 2 and "c.exr" in err
    code, _, err = run("compare", str(first), "--no-picture")
    assert code == 2 and "pass `against`" in err


def test_the_command_stores_references(tmp_path: Path) -> None:
    target, report = str(tmp_path / "box.exr"), str(tmp_path / "box.html")
    small = ("--width", "8", "--spp", "16", "--rfilter", "box")
    code, out, _ = run("compare", "cornell_box", "--store", target, *small)
    assert code == 0 and "8 x 8, 16 spp" in out
    code, out, _ = run("compare", "cornell_box", target, *small, "--same-seed", "1", "--report", report)
    assert code == 0 and f"report: {report}" in out and "picture" not in out, out
    assert Path(report).read_text().startswith("<!doctype html>")
    for wrong in (("--report", "x.png"), ("--store", target, "--json"), ("--store", target, "--report", report)):
        assert run("compare", "cornell_box", *wrong)[0] == 2
    assert run("compare", "cornell_box", "cornell_box", "--store", target)[0] == 2


ONE_THREAD = """
import sys
import djpt, drjit as dr, numpy as np
from djpt.validation.bridge import mitsuba_renderer
dr.set_thread_count(1)
djpt.write(sys.argv[1], np.ones((8, 16, 3), np.float32))
scene = djpt.cornell_box()
scene["sensor"]["film"] |= {"width": 4, "height": 4}
render = mitsuba_renderer({**scene, "sky": {"type": "envmap", "filename": sys.argv[1]}})
print(render(1, 0).shape, dr.thread_count())
"""


def test_mitsuba_reads_exr_files_with_a_single_thread(mi: Any, tmp_path: Path) -> None:
    done = run_python("-c", ONE_THREAD, str(tmp_path / "sky.exr"), timeout=100)
    assert done.stdout.split("\n")[0] == "(4, 4, 3) 1", done.stderr
