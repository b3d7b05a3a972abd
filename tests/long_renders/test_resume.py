"""The command line: checkpoints that survive any end of the process, limits, and sums of checkpoints."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from djpt.apps.cli.console import ExitCode
from djpt.apps.cli.passes import seconds_of, share_of, status
from djpt.errors import RenderError
from djpt.images.image import read_metadata, read_pixels
from djpt.rendering.progressive.accumulation import Accumulation
from tests.kit.commands import run
from tests.long_renders.test_passes import box, last

SMALL = ["render", "cornell_box", "--width", "16"]
LONG = [*SMALL, "--spp", "8192", "--checkpoint", "job.djpt", "--every", "0.001s", "--resume", "-o", "a.npy", "-q"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def begun(*further: str) -> subprocess.Popen[str]:
    """A process that renders; it has written a checkpoint, or has ended."""
    command = [sys.executable, "-m", "djpt", *LONG, *further]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ)
    before = Path("job.djpt").stat().st_mtime_ns if Path("job.djpt").exists() else 0
    while process.poll() is None and not (Path("job.djpt").exists() and Path("job.djpt").stat().st_mtime_ns != before):
        time.sleep(0.005)
    return process


def killed_and_resumed(times: int, *further: str) -> None:
    """Kill a render a number of times, each time a bit later; go on, and compare with one that nothing disturbs."""
    adaptive = "--adaptive" in further
    undisturbed = last(box(size=16, rfilter="gaussian"), spp=8192, adaptive=adaptive).image().numpy()
    chance, kills = random.Random(3), 0
    for _ in range(times):
        process = begun(*further)
        time.sleep(chance.uniform(0, 0.05))
        process.kill()
        process.communicate()
        kills += process.returncode == -signal.SIGKILL
    assert kills > times // 2, "the render ended before it was killed"
    run(*LONG, *further)
    np.testing.assert_array_equal(np.load("a.npy"), undisturbed)
    assert {path.name for path in Path().iterdir()} == {"job.djpt", "a.npy"}


def test_two_kills_cost_no_bit() -> None:
    killed_and_resumed(2)


@pytest.mark.slow
@pytest.mark.parametrize("further", [[], ["--adaptive"]])
def test_twenty_kills_cost_no_bit(further: list[str]) -> None:
    killed_and_resumed(20, *further)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_write_the_checkpoint(number: int, code: int) -> None:
    process = begun()
    process.send_signal(number)
    _, text = process.communicate(timeout=60)
    assert process.returncode == code
    assert "'job.djpt' holds the partial image" in text
    assert not Path("a.npy").exists()
    found = Accumulation.load("job.djpt")
    assert found.rounds > 0
    assert f"ed after {100 * found.spp / 8192:.3g} % of the samples: " in text


def test_a_checkpoint_goes_on_and_is_not_overwritten() -> None:
    assert run(*SMALL, "--spp", "64", "--checkpoint", "a.djpt", "-o", "a.exr")[0] == ExitCode.DONE
    code, _, error = run(*SMALL, "--spp", "128", "--checkpoint", "a.djpt", "-o", "a.exr")
    assert (code, "exists: continue from it (--resume)" in error) == (ExitCode.BAD_INPUT, True)
    code, out, _ = run(*SMALL, "--spp", "128", "--checkpoint", "a.djpt", "--resume", "-o", "a.exr")
    assert (code, out.startswith("a.exr: 16 x 16, 128 spp, error ")) == (ExitCode.DONE, True)
    expected = last(box(size=16, rfilter="gaussian"), spp=128)
    np.testing.assert_array_equal(read_pixels("a.exr"), expected.image().numpy())
    assert read_metadata("a.exr")["spp"] == "128"
    code, _, error = run(*SMALL, "--height", "9", "--checkpoint", "a.djpt", "--resume")
    assert (code, "the film" in error) == (ExitCode.BAD_INPUT, True)


def test_the_samples_are_those_that_were_asked_for() -> None:
    """Also if they aren't whole rounds; and the file says so."""
    options = ["--checkpoint", "a.djpt", "--resume", "-o", "a.exr"]
    code, out, error = run(*SMALL, "--spp", "200", *options)
    assert (code, out.startswith("a.exr: 16 x 16, 200 spp, error ")) == (ExitCode.DONE, True), error
    assert read_metadata("a.exr")["spp"] == "200"
    assert Accumulation.load("a.djpt").counts == (64, 64, 64, 8)
    code, _, error = run(*SMALL, "--spp", "256", *options, "--schedule", "wave")
    assert (code, "its schedule is 'auto', not 'wave'" in error) == (ExitCode.BAD_INPUT, True)
    code, out, _ = run(*SMALL, "--spp", "256", *options)
    assert (code, out.startswith("a.exr: 16 x 16, 256 spp, error ")) == (ExitCode.DONE, True)
    expected = last(box(size=16, rfilter="gaussian"), spp=256)
    np.testing.assert_array_equal(read_pixels("a.exr"), expected.image().numpy())
    assert Accumulation.load("a.djpt").counts == (64, 64, 64, 64)


def test_checkpoints_of_different_seeds_are_merged() -> None:
    for seed in ("0", "1"):
        run(*SMALL, "--spp", "64", "--seed", seed, "--checkpoint", f"{seed}.djpt", "-o", f"{seed}.npy", "-q")
    code, out, error = run("merge", "0.djpt", "1.djpt", "-o", "all.npy")
    assert (code, out.startswith("all.npy: 16 x 16, 128 spp, error ")) == (ExitCode.DONE, True), error
    # With a filter the sums of the weights differ a bit.
    np.testing.assert_allclose(np.load("all.npy"), (np.load("0.npy") + np.load("1.npy")) / 2, rtol=0.3, atol=0.05)
    assert run("merge", "0.djpt", "1.djpt", "-o", "all.djpt")[0] == ExitCode.DONE
    assert Accumulation.load("all.djpt").spp == 128
    assert run("merge", "0.djpt", "1.djpt", "-o", "all.png")[0] == ExitCode.DONE
    code, _, error = run("merge", "0.djpt", "0.djpt", "-o", "all.npy")
    assert (code, "both contain the round of seed 0" in error) == (ExitCode.BAD_INPUT, True)
    assert run("merge", "0.djpt")[0] == ExitCode.BAD_INPUT


def test_a_render_stops_when_it_is_good() -> None:
    code, out, _ = run(*SMALL, "--target-error", "30%", "--time-budget", "5m", "-o", "a.png")
    assert code == ExitCode.DONE
    assert float(out.partition("error ")[2].partition("%")[0]) <= 30


def test_adaptive_renders_of_the_command_line() -> None:
    code, out, error = run(*SMALL, "--spp", "64", "--adaptive", "--checkpoint", "a.djpt", "-o", "a.npy")
    assert (code, out.startswith("a.npy: 16 x 16, 64 spp, error ")) == (ExitCode.DONE, True), error
    expected = last(box(size=16, rfilter="gaussian"), spp=64, adaptive=True)
    np.testing.assert_array_equal(np.load("a.npy"), expected.image().numpy())
    assert run("merge", "a.djpt", "-o", "b.npy")[0] == ExitCode.DONE
    np.testing.assert_array_equal(np.load("b.npy"), expected.image().numpy())
    code, _, error = run(*SMALL, "--spp", "128", "--checkpoint", "a.djpt", "--resume", "-o", "a.npy")
    assert (code, "begun with adaptive=True" in error) == (ExitCode.BAD_INPUT, True)


def test_the_line_says_why_a_render_will_stop() -> None:
    found = last(box(), spp=16, round_spp=4)
    error = found.error().overall
    assert status(found, 16, 2.0, 160, None, None).endswith("18 s left until 160 spp")
    assert status(found, 16, 2.0, 160, error / 2, None).endswith(f"6 s left until an error of {error / 2:.3g}")
    assert status(found, 16, 2.0, 160, error / 2, 5.0).endswith("3 s left until 5 s")
    assert status(found, 16, 2.0, 0, None, None) == f"16 spp, error {error:.2%}, 1.15 ksamples/s"
    assert "error unknown" in status(last(box(), spp=4), 4, 1.0, 8, 0.1, None)


def test_times_and_shares() -> None:
    assert [seconds_of(text) for text in ("90", "90s", "1.5m", "1h30m", "1d")] == [90, 90, 90, 5400, 86400]
    assert [share_of(text) for text in ("1%", "0.01", "250%")] == [0.01, 0.01, 2.5]
    for text in ("", "m", "10x", "-3s", "0", "1h 3m", "inf"):
        with pytest.raises(RenderError, match="a time is"):
            seconds_of(text)
    for text in ("", "%", "0", "-1%", "nan", "inf", "a"):
        with pytest.raises(RenderError, match="an error is"):
            share_of(text)
