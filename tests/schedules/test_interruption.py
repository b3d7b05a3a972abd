"""Signals end a render after the pass at hand, keep what exists if asked, and leave all else as it was."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.files import unfinished
from djpt.core.interruption import ending_at_once, interruptible
from djpt.images.image import read_pixels
from djpt.rendering.schedules import passes
from djpt.scene.scene import Scene

SPP = 12
SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])


@pytest.fixture(autouse=True)
def handlers() -> Any:
    """The handlers, which are the same afterwards."""
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    yield
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def white(rfilter: str = "box", integrator: str = "path") -> Scene:
    """A ball in front of a white sky: each sample of it is 1."""
    film = {"type": "hdrfilm", "width": 16, "height": 13, "rfilter": {"type": rfilter}}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": integrator},
            "sensor": {"type": "perspective", "film": film, "sampler": {"type": "independent"}},
            "sky": {"type": "constant", "radiance": 1.0},
            "ball": {"type": "sphere", "center": [0, 0, -9]},
        }
    )


def sends(number: int, after: int = 1) -> Callable[[int, int], None]:
    """A progress function that raises a signal when it is called for a time."""
    calls = []

    def progress(done: int, total: int) -> None:
        calls.append(done)
        if len(calls) == after:
            signal.raise_signal(number)

    return progress


@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_what_exists_is_kept_with_its_own_weights(rfilter: str, schedule: str) -> None:
    scene = white(rfilter)
    with pytest.raises(KeyboardInterrupt, match=r"after 33.3 % of the samples: the film keeps what exists"):
        options: dict[str, Any] = {"spp": SPP, "pass_spp": 4, "schedule": schedule}
        djpt.render(scene, progress=sends(signal.SIGINT), keep_partial=True, **options)
    image = scene.sensors()[0].film().develop()
    np.testing.assert_allclose(image.numpy(), 1, rtol=1e-5)


@pytest.mark.parametrize("schedule", ["flat", "wave"])
def test_all_pixels_have_the_samples_of_the_passes_until_then(schedule: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The image of 8 of 12 samples, in two passes over three bands, is that of their sums."""
    monkeypatch.setattr(passes, "SUMMED_PIXELS", 100)
    monkeypatch.setattr(passes, "STORED_PIXELS", (75, 100))
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=12, height=20, rfilter={"type": "box"})
    scene = djpt.load_dict(description)
    with pytest.raises(djpt.Terminated) as caught:
        options: dict[str, Any] = {"spp": SPP, "pass_spp": 4, "schedule": schedule}
        djpt.render(scene, progress=sends(signal.SIGTERM, after=2 * 3), keep_partial=True, **options)
    assert caught.value.code == 143
    part = scene.sensors()[0].film().develop().numpy().copy()
    held = []

    def keep(job: Any, add: Any, pixels: int, spp: int) -> Any:
        for band in job.bands(pixels):
            first = add(job, band, 0, 8, None)
            held.append(np.stack([np.array(total) for total in passes.total(job, band, first)], axis=1))
            yield band, add(job, band, 8, SPP, first), SPP

    monkeypatch.setattr(passes, "sums_of_bands", keep)
    djpt.render(scene, spp=SPP, schedule=schedule)
    np.testing.assert_array_equal(part, (np.concatenate(held) / np.float32(8)).reshape(20, 12, 3))


def test_the_first_sample_of_each_pixel_is_always_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "SUMMED_PIXELS", 50)
    scene = white()
    with pytest.raises(KeyboardInterrupt):
        djpt.render(scene, spp=SPP, pass_spp=4, progress=sends(signal.SIGINT), keep_partial=True)
    np.testing.assert_array_equal(scene.sensors()[0].film().develop().numpy(), 1)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_rows_are_kept_where_memory_is_short(rfilter: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "holds_all_sums", lambda job: False)
    monkeypatch.setattr(passes, "SUMMED_PIXELS", 80)
    monkeypatch.setattr(passes, "FILTERED_PIXELS", 80)
    with pytest.raises(KeyboardInterrupt):
        options: dict[str, Any] = {"spp": SPP, "pass_spp": SPP, "keep_partial": True}
        djpt.render_to_file(white(rfilter), tmp_path / "a.exr", progress=sends(signal.SIGINT, 2), **options)
    rows = read_pixels(tmp_path / "a.exr").mean(axis=(1, 2))
    finished = 10 if rfilter == "box" else 8
    np.testing.assert_allclose(rows, [1] * finished + [0] * (13 - finished), rtol=1e-5)


def test_light_paths_are_kept() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=16, height=16)
    description["integrator"] = {"type": "ptracer", "max_depth": 2, "hide_emitters": True}
    scene = djpt.load_dict(description)
    with pytest.raises(KeyboardInterrupt):
        djpt.render(scene, spp=400, pass_spp=100, progress=sends(signal.SIGINT), keep_partial=True)
    part = scene.sensors()[0].film().develop().numpy().copy()
    np.testing.assert_array_equal(part, djpt.render(scene, spp=100).numpy())


def test_an_undisturbed_render_is_as_ever_and_has_derivatives() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=12, height=12)
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    images = [djpt.render(scene, params, spp=8, keep_partial=keeps) for keeps in (False, True)]
    gradients = []
    for image in images:
        dr.clear_grad(params["red.reflectance.value"])
        dr.backward(dr.mean(image.array))
        gradients.append(np.array(dr.grad(params["red.reflectance.value"])))
    np.testing.assert_array_equal(images[0].numpy(), images[1].numpy())
    np.testing.assert_array_equal(gradients[0], gradients[1])
    assert np.any(gradients[0] > 0)


@SIGNALS
def test_files_are_written_or_not(number: int, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    error = KeyboardInterrupt if number == signal.SIGINT else djpt.Terminated
    options: dict[str, Any] = {"spp": SPP, "pass_spp": 3}
    with pytest.raises(error, match="nothing is kept"):
        djpt.render_to_file(white(), path, progress=sends(number), **options)
    assert (list(tmp_path.iterdir()), unfinished) == ([], set())
    with pytest.raises(error, match=r"a\.exr' holds the partial image"):
        djpt.render_to_file(white(), path, progress=sends(number), keep_partial=True, **options)
    assert (read_pixels(path) == 1).all()
    assert djpt.read_metadata(path)["spp"] == "3"
    assert (list(tmp_path.iterdir()), unfinished) == ([path], set())


def test_a_second_interrupt_ends_the_pass() -> None:
    with pytest.raises(KeyboardInterrupt, match="twice"), interruptible(keeps=True) as interruption:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        assert interruption.signal == signal.SIGTERM
        signal.raise_signal(signal.SIGINT)


def test_handlers_of_others_are_left_alone() -> None:
    def own(*_: object) -> None:
        """Of a program that uses djpt."""

    before = signal.signal(signal.SIGINT, own)
    try:
        with interruptible(keeps=False):
            assert signal.getsignal(signal.SIGINT) is own
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_have_no_signals(tmp_path: Path) -> None:
    thread = threading.Thread(target=djpt.render_to_file, args=(white(), tmp_path / "a.exr"), kwargs={"spp": 1})
    thread.start()
    thread.join()
    assert (tmp_path / "a.exr").exists()


def test_listening_ends() -> None:
    threads = threading.active_count()
    with ending_at_once():
        assert threading.active_count() == threads + 1
    assert (threading.active_count(), signal.set_wakeup_fd(-1)) == (threads, -1)


COMMAND = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it for what runs in the background
import djpt.apps.cli.render
from djpt.apps.cli.main import run
shown = djpt.apps.cli.render.progress_bar
import contextlib
@contextlib.contextmanager
def told(title, unit, quiet):
    calls = []
    def progress(done, total):
        calls.append(done)
        if len(calls) == 2:
            print("begun", flush=True)
    yield progress
djpt.apps.cli.render.progress_bar = told
sys.argv = ["djpt", "render", "cornell_box", "--width", "32", "--spp", "1000000", "-o", *sys.argv[1:]]
run()
"""


def stopped(folder: Path, number: int, *arguments: str, times: int = 1) -> tuple[int, str, list[str]]:
    """Status, errors and files of a command that gets a signal, some times in a row, after two passes."""
    command = [sys.executable, "-c", COMMAND, *arguments]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "begun\n"
        for _ in range(times):
            process.send_signal(number)
        errors = process.stderr.read()
        return process.wait(timeout=60), errors, sorted(path.name for path in folder.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
def test_commands_end_with_one_line_and_a_status(tmp_path: Path) -> None:
    status, errors, files = stopped(tmp_path, signal.SIGINT, "a.exr")
    assert (status, files) == (130, [])
    assert errors.startswith("djpt: error: interrupted after ") and errors.endswith(": nothing is kept\n")
    status, errors, files = stopped(tmp_path, signal.SIGTERM, "a.exr", "--keep-partial")
    assert (status, files) == (143, ["a.exr"])
    assert errors.startswith("djpt: error: terminated after ") and errors.endswith(
        ": 'a.exr' holds the partial image\n"
    )
    assert 0 < float(djpt.read_metadata(tmp_path / "a.exr")["spp"]) < 1000000
    assert 0.05 < read_pixels(tmp_path / "a.exr").mean() < 0.5
