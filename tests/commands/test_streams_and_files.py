"""Processes without standard streams, and options that name one file twice."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.images.image import read_pixels
from tests.kit.commands import run

SMALL = ["cornell_box", "--width", "16", "--spp", "4"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


# ---- streams -----------------------------------------------------------------------------------


@pytest.mark.sparse(9)
@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell that closes streams")
@pytest.mark.parametrize("closed", ["2>&-", ">&-", ">&- 2>&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize("further", [[], ["--checkpoint", "a.djpt"]], ids=["plain", "rounds"])
def test_an_image_is_written_without_standard_streams(closed: str, further: list[str]) -> None:
    command = ["render", *SMALL, *further, "-o", "a.exr"]
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-m", "djpt", *command],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (ExitCode.DONE, "")
    assert done.stdout.startswith("a.exr: 16 x 16, 4 spp, ") == (closed == "2>&-")
    assert run("render", *SMALL, "-o", "b.exr", "-q")[0] == ExitCode.DONE
    np.testing.assert_array_equal(read_pixels("a.exr"), read_pixels("b.exr"))


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell that closes streams")
def test_errors_keep_their_code_without_standard_streams() -> None:
    for closed in ("2>&-", ">&-"):
        done = subprocess.run(
            ["sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-m", "djpt", "render", "nowhere.xml"],
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert (done.returncode, done.stdout) == (ExitCode.BAD_INPUT, "")
        assert ("nowhere.xml" in done.stderr) == (closed == ">&-")


# ---- files -------------------------------------------------------------------------------------


def textured() -> None:
    """Write a scene file with a texture beside it."""
    djpt.write("paint.png", np.full((2, 2, 3), 0.5, np.float32))
    description = djpt.cornell_box()
    description["white"]["reflectance"] = {"type": "bitmap", "filename": "paint.png"}
    djpt.write_dict("scene.xml", description)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "l.exr", "--checkpoint", "l.exr"], "--output and --checkpoint are the same file, 'l.exr'"),
        (["-o", "l.exr", "--checkpoint", "./x/../l.exr"], "--output and --checkpoint are the same file"),
        (["--checkpoint", "cornell_box.exr"], "--output and --checkpoint are the same file, 'cornell_box.exr'"),
        (["-o", "l.exr", "--checkpoint", "link.exr"], "--output and --checkpoint are the same file, 'link.exr'"),
        (["--checkpoint", "c.png", "--preview", "c.png"], "--checkpoint and --preview are the same file, 'c.png'"),
        (["-o", "p.png", "--preview", "p.png"], "--output and --preview are the same file, 'p.png'"),
        (["-o", "a.exr", "--denoise", "--raw", "a.exr"], "--output and --raw are the same file, 'a.exr'"),
    ],
)
def test_outputs_of_a_render_differ(options: list[str], message: str) -> None:
    Path("x").mkdir()
    Path("link.exr").symlink_to("l.exr")
    code, _, error = run("render", *SMALL, *options)
    assert (code, message in error) == (ExitCode.BAD_INPUT, True), error
    assert {path.name for path in Path().iterdir()} == {"x", "link.exr"}


def test_no_output_replaces_a_file_of_the_scene() -> None:
    textured()
    before = Path("paint.png").read_bytes()
    for options in (["-o", "paint.png"], ["-o", "a.exr", "--preview", "paint.png"]):
        code, _, error = run("render", "scene.xml", "--width", "8", "--spp", "1", *options)
        assert (code, "are the same file, 'paint.png'" in error) == (ExitCode.BAD_INPUT, True), error
    assert Path("paint.png").read_bytes() == before
    assert run("render", "scene.xml", "--width", "8", "--spp", "1", "-o", "a.png")[0] == ExitCode.DONE


def test_no_output_replaces_what_was_read() -> None:
    image = np.full((8, 8, 3), 0.5, np.float32)
    djpt.write("a.exr", image)
    djpt.write("a.png", image)
    assert run("render", *SMALL, "--checkpoint", "a.djpt", "-o", "b.exr")[0] == ExitCode.DONE
    for command in (
        ["tonemap", "a.png", "-o", "a.png"],
        ["denoise", "a.exr", "--denoiser", "nlm", "-o", "a.exr"],
        ["merge", "a.djpt", "-o", "a.djpt"],
        ["compare", "a.png", "a.exr", "-o", "a.png"],
        ["compare", "b.exr", "a.png", "-o", "a.png"],
    ):
        before = {path: path.read_bytes() for path in Path().iterdir()}
        code, _, error = run(*command)
        assert (code, "are the same file" in error) == (ExitCode.BAD_INPUT, True), (command, error)
        assert {path: path.read_bytes() for path in Path().iterdir()} == before
