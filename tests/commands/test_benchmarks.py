"""``djpt benchmarks``: which scenes it measures, what it finds, and how the table sums it up."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from djpt.apps.benchmarks.run import scenes_named
from djpt.apps.benchmarks.table import SceneRow, line, numbers, summary
from djpt.apps.cli.console import ExitCode
from djpt.errors import FileError, SceneError
from tests.kit.commands import run
from tests.kit.processes import run_python

SCENE = """<scene version="3.0.0">
    <integrator type="direct"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="64"/><integer name="height" value="32"/><rfilter type="box"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere"/>
</scene>
"""

ROW = SceneRow("ball.xml", load=(0.2, 0.1), first=(0.3, 0.2), image=[(0.4, 0.2), (0.6, 0.2), (0.3, 0.3)], equal=0.999)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "include").mkdir()
    (tmp_path / "inner").mkdir()
    (tmp_path / "include" / "camera.xml").write_text(SCENE)
    (tmp_path / "inner" / "ball.xml").write_text(SCENE)
    (tmp_path / "whole.xml").write_text('<scene version="3.0.0"><include filename="include/camera.xml"/></scene>')
    (tmp_path / "shape.xml").write_text('<scene version="3.0.0"><shape type="sphere"/></scene>')
    (tmp_path / "settings.xml").write_text("<settings/>")
    return tmp_path


# ---- which scenes --------------------------------------------------------------------------


def test_a_folder_stands_for_its_whole_scenes(folder: Path) -> None:
    assert [name for name, _ in scenes_named([str(folder)])] == ["inner/ball.xml", "whole.xml"]
    assert [name for name, _ in scenes_named([str(folder)], only="inner")] == ["inner/ball.xml"]
    assert [name for name, _ in scenes_named([str(folder)], only="*le.xml")] == ["whole.xml"]


def test_files_and_built_in_scenes_are_named_as_they_are(folder: Path) -> None:
    file = str(folder / "inner" / "ball.xml")
    assert scenes_named([file, "cornell_box"]) == [("ball.xml", file), ("cornell_box", "cornell_box")]


def test_scenes_that_are_not_there(folder: Path) -> None:
    with pytest.raises(FileError, match="there is no such file"):
        scenes_named([str(folder / "bal.xml")])
    with pytest.raises(SceneError, match="cornell_box"):
        scenes_named(["cornel_box"])
    with pytest.raises(SceneError, match=r"has no scene file .* contains 'nothing'"):
        scenes_named([str(folder)], only="nothing")


# ---- the table -----------------------------------------------------------------------------


def test_a_row_has_the_median_of_its_pairs() -> None:
    assert (ROW.ratio, ROW.first_ratio, ROW.load_ratio) == (2, pytest.approx(1.5), 2)
    assert numbers(ROW)["ratio"] == 2
    assert "2.00" in line(ROW) and "400 / 200" in line(ROW) and "99.90%" in line(ROW)


def test_what_rows_have_in_common() -> None:
    slow = replace(ROW, name="slow.xml", image=[(0.1, 0.2)], equal=0.5, bias=0.1, bias_in_errors=3.0, rmse=0.2)
    failed = SceneRow("broken.xml", failures={"mitsuba": "load: no such plugin"})
    text = "\n".join(summary([ROW, slow, failed]))
    assert "Slower than Mitsuba: 1 of 2\n   0.50  slow.xml" in text
    assert "Below 99%: 1\n   50.00%  slow.xml" in text
    assert "Not rendered by both: 1" in text
    (image,) = (words for words in text.splitlines() if words.startswith("image "))
    assert image.split()[1] == "0.50" and image.split()[8] == "1.00"  # smallest, geometric mean of 2 and 0.5
    assert "load: no such plugin" in line(failed)


# ---- measuring -----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_scene_is_measured(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "ball.xml").write_text(SCENE)
    arguments = ["ball.xml", "--width", "16", "--samples", "256", "--pairs", "2", "--json", "out.json"]
    done = run_python("-m", "djpt.benchmarks", *arguments, cwd=tmp_path)
    assert done.returncode == ExitCode.DONE, done.stderr
    assert "about 256 samples, 2 pairs, wall time" in done.stdout
    found = json.loads((tmp_path / "out.json").read_text())
    (row,) = found["rows"]
    assert found["machine"]["mitsuba"]
    assert (row["failures"], row["more"]["shape"], row["more"]["spp"]) == ({}, [8, 16, 3], 2)
    assert len(row["image"]) == 2 and row["ratio"] > 0 and row["first_ratio"] > 0 and row["load_again_ratio"] > 0
    assert row["equal"] > 0.98


@pytest.mark.slow
def test_a_scene_that_cannot_be_rendered_is_reported(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    (tmp_path / "broken.xml").write_text(SCENE.replace('"sphere"', '"spere"'))
    done = run_python("-m", "djpt", "benchmarks", "broken.xml", cwd=tmp_path)
    assert done.returncode == ExitCode.DIFFERENT, done.stderr
    assert "djpt: load: " in done.stdout and "did you mean 'sphere'?" in done.stdout


def test_options_are_checked() -> None:
    code, _, error = run("benchmarks", "cornell_box", "--pairs", "0")
    assert code == ExitCode.BAD_INPUT and "--pairs must be at least 1, found 0" in error
    code, _, error = run("benchmarks", "nothing.xml")
    assert code == ExitCode.BAD_INPUT and "nothing.xml" in error
