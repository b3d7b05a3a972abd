"""Frames of animations: what is written, and what a later run goes on with."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.animation.frames import JOB, render_frames
from djpt.apps.animation.tracks import Track
from djpt.errors import FileError, ParameterError
from djpt.rendering.progressive.rounds import round_seed
from djpt.scenes.overrides import described, override

KEY = "white.reflectance.value"
TRACK = Track.of({0: [0.1, 0.1, 0.1], 4: [0.9, 0.5, 0.1]})


def scene(**options: Any) -> djpt.Scene:
    return djpt.load_dict(override(described("cornell_box")[1], width=12, **options))


def hashes(folder: Path) -> dict[str, str]:
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(folder.glob("*.exr"))}


def test_each_frame_is_the_image_of_its_parameters(tmp_path: Path) -> None:
    loaded = scene()
    before = np.array(djpt.traverse(loaded)[KEY])
    files = list(render_frames(loaded, {KEY: TRACK}, 3, tmp_path / "new", suffix=".npy", spp=4, seed=5))
    assert [file.name for file in files] == ["0000.npy", "0001.npy", "0002.npy"]
    assert np.array_equal(np.array(djpt.traverse(loaded)[KEY]), before)
    params = djpt.traverse(loaded)
    params.update({KEY: TRACK.at(2)})
    expected = djpt.render(loaded, spp=4, seed=round_seed(5, 2))
    assert np.array_equal(np.load(files[2]), expected.numpy())


def test_a_run_goes_on_with_what_is_missing(tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    list(render_frames(scene(), {KEY: TRACK}, 5, whole, suffix=".exr", spp=2))
    frames = render_frames(scene(), {KEY: TRACK}, 5, parts, suffix=".exr", spp=2)
    next(frames), next(frames)
    frames.close()  # type: ignore[attr-defined]
    (parts / "0000.exr").unlink()
    kept = (parts / "0001.exr").stat().st_mtime_ns
    assert len(list(render_frames(scene(), {KEY: TRACK}, 5, parts, suffix=".exr", spp=2))) == 5
    assert (parts / "0001.exr").stat().st_mtime_ns == kept
    assert hashes(parts) == hashes(whole)


@pytest.mark.parametrize(
    "change", [{"spp": 4}, {"seed": 1}, {"facts": {"tonemap": "agx"}}, {"track": Track.of({0: 0.5})}, {"width": 13}]
)
def test_a_folder_holds_one_animation(tmp_path: Path, change: dict[str, Any]) -> None:
    list(render_frames(scene(), {KEY: TRACK}, 1, tmp_path, spp=2))
    given = {"spp": 2, **change}
    track = given.pop("track", TRACK)
    loaded = djpt.load_dict(override(described("cornell_box")[1], width=given.pop("width", 12)))
    with pytest.raises(FileError, match="another animation"):
        render_frames(loaded, {KEY: track}, 1, tmp_path, **given)


def test_a_note_that_is_damaged(tmp_path: Path) -> None:
    (tmp_path / JOB).write_text("[]")
    with pytest.raises(FileError, match="can't be read"):
        render_frames(scene(), {KEY: TRACK}, 1, tmp_path)


def test_wrong_parameters(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"white\.reflectance\.value"):
        render_frames(scene(), {"white.reflectance.valeu": TRACK}, 1, tmp_path)
    with pytest.raises(ParameterError, match=r"white\.reflectance\.value"):
        list(render_frames(scene(), {KEY: Track.of({0: -1})}, 1, tmp_path))


@pytest.mark.slow
def test_sixty_frames_survive_being_killed(tmp_path: Path) -> None:
    """SIGKILL at any moment: in the end every frame is there once, with the bits of an undisturbed run."""
    command = [sys.executable, "-m", "djpt", "animate", "cornell_box", "--width", "16", "--spp", "4", "--frames", "60"]
    command += ["--format", "exr", "--set", f"{KEY}=0:0.1,0.1,0.1;59:0.9,0.5,0.1", "-q", "-o"]
    subprocess.run([*command, str(tmp_path / "whole")], check=True)
    rng, killed = np.random.default_rng(0), tmp_path / "killed"
    for _ in range(5):
        process = subprocess.Popen([*command, str(killed)])
        before = len(hashes(killed)) if killed.exists() else 0
        while process.poll() is None and (not killed.exists() or len(list(killed.glob("*.exr"))) <= before):
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run([*command, str(killed)], check=True)
    assert hashes(killed) == hashes(tmp_path / "whole")
    assert len(hashes(killed)) == 60
    assert sorted(file.name for file in killed.iterdir() if not file.name.endswith(".exr")) == [JOB]
