"""What the command line writes of images with more channels than the file holds, and what it says meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.images.image import read_pixels
from tests.kit.commands import run

LAYERS = """
<scene version="3.0.0">
    <integrator type="aov"><string name="aovs" value="d:depth, n:sh_normal"/><integrator type="path"/></integrator>
    <emitter type="constant"/>
    <shape type="sphere"/>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/> <integer name="height" value="6"/>
            <string name="pixel_format" value="FORMAT"/>
        </film>
    </sensor>
</scene>
"""


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)


def render(output: str, form: str = "rgb", *options: str) -> tuple[int, str, str]:
    Path("layers.xml").write_text(LAYERS.replace("FORMAT", form))
    return run("render", "layers.xml", "--spp", "2", "-o", output, *options)


# ---------------------------------------------------------------- layers


def test_a_picture_gets_the_colours_and_the_rest_is_named() -> None:
    code, out, err = render("a.png")
    assert code == ExitCode.DONE, err
    assert out.endswith("without d, n: exr and npy hold all channels\n")
    assert read_pixels("a.png").shape == (6, 8, 3)
    code, out, _ = render("all.exr")
    assert code == ExitCode.DONE and "without" not in out
    assert read_pixels("all.exr").shape == (6, 8, 7)
    assert render("linear.hdr")[0] == ExitCode.DONE
    np.testing.assert_allclose(read_pixels("linear.hdr"), read_pixels("all.exr")[..., :3], rtol=0.01, atol=1e-2)


def test_colours_can_be_tone_mapped_without_the_layers() -> None:
    code, _, err = render("a.png", "rgb", "--tonemap", "aces")
    assert code == ExitCode.DONE, err


@pytest.mark.parametrize(("form", "count"), [("rgba", 4), ("luminance_alpha", 2)])
def test_alpha_is_kept_where_it_can_be(form: str, count: int) -> None:
    assert render("a.png", form)[0] == ExitCode.DONE
    assert read_pixels("a.png").shape[2] == count
    assert render("a.pfm", form)[0] == ExitCode.DONE
    assert read_pixels("a.pfm").shape[2] == count - 1


def test_a_file_that_holds_no_such_colour_is_refused_before_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(djpt, "render", lambda *args, **options: pytest.fail("rendered all the same"))
    code, _, err = render("a.hdr", "luminance")
    assert code == ExitCode.BAD_INPUT
    assert err == "djpt: error: can't write 'a.hdr': hdr holds 3 channels, this film makes Y; exr and npy hold any\n"


# ---------------------------------------------------------------- words


@pytest.mark.parametrize("width", [40, 80])
@pytest.mark.sparse(2)
def test_the_list_of_commands_is_not_cut_off(width: int) -> None:
    command: list[Any] = [sys.executable, "-m", "djpt", "--help"]
    environment = {**os.environ, "COLUMNS": str(width)}
    out = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120, check=True).stdout
    assert "..." not in out.partition("Commands:")[2]
    text = " ".join(out.split())
    assert "Write a page that compares the errors of all algorithms." in text
    assert max(map(len, out.splitlines())) <= max(width, 60)  # beyond that, Click keeps a column for the words


def test_a_gallery_in_a_pipe_says_what_it_renders() -> None:
    code, _, err = run("gallery", "diffuse", "null", "--size", "8", "--spp", "1", "-o", "a.png")
    assert code == ExitCode.DONE, err
    assert err == "1 of 2: diffuse, reflectance\n2 of 2: null, no surface\n"
    assert run("gallery", "null", "--size", "8", "--spp", "1", "-o", "a.png", "--quiet")[2] == ""
