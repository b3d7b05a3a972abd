"""Renders and gradients on workers: the bits of one machine, whatever happens to the workers."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.apps.cluster import rendering
from djpt.apps.cluster.work import Bundle
from djpt.errors import BackendError, DjptError, FileError, ParameterError, RenderError, SceneError
from djpt.rendering.progressive.rounds import round_seed
from djpt.scenes.overrides import described, override
from tests.kit.commands import run

distributed = pytest.importorskip("distributed")

import djpt.apps.cluster  # noqa: E402


def box(**options: Any) -> dict[str, Any]:
    return override(described("cornell_box")[1], width=16, **options)


class Cluster:
    """A scheduler, and workers that are processes of their own."""

    def __init__(self, scheduler: Any) -> None:
        self.scheduler = scheduler
        self.client = distributed.Client(scheduler)
        self.workers: list[subprocess.Popen[bytes]] = []

    def add(self) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "djpt", "worker", self.scheduler.scheduler_address, "--threads", "1"]
        self.workers.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        return self.workers[-1]

    def wait(self, count: int) -> None:
        self.client.wait_for_workers(count, timeout=120)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with distributed.LocalCluster(
        n_workers=0, dashboard_address=None, protocol="tcp://", host="127.0.0.1"
    ) as scheduler:
        result = Cluster(scheduler)
        result.add()
        result.wait(1)
        yield result
        result.client.close()
        for worker in result.workers:
            worker.kill()
            worker.wait()


def last(images: Iterator[Any]) -> Any:
    return list(images)[-1]


def test_the_bits_are_those_of_one_machine(cluster: Cluster) -> None:
    expected = last(djpt.render_passes(djpt.load_dict(box()), spp=12, round_spp=4, seed=7))
    found = last(djpt.apps.cluster.render_passes(cluster.client, box(), spp=12, round_spp=4, seed=7))
    assert found.rounds == 3
    assert np.array_equal(found.image().numpy(), expected.image().numpy())
    assert found.error().overall == expected.error().overall
    # Whoever began, the other can go on.
    more = last(djpt.render_passes(djpt.load_dict(box()), spp=16, seed=7, resume_from=found))
    assert np.array_equal(
        more.image().numpy(),
        last(djpt.apps.cluster.render_passes(cluster.client, box(), spp=16, seed=7, resume_from=expected))
        .image()
        .numpy(),
    )


def test_a_render_that_is_left_early(cluster: Cluster) -> None:
    images = djpt.apps.cluster.render_passes(cluster.client, box(), spp=4000, round_spp=4)
    next(images)
    images.close()  # type: ignore[attr-defined]
    deadline = time.monotonic() + 30
    while cluster.client.processing() and any(cluster.client.processing().values()):
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.slow
def test_workers_that_are_killed_join_and_leave(cluster: Cluster) -> None:
    options = {"spp": 160, "round_spp": 4, "seed": 3}
    expected = last(djpt.render_passes(djpt.load_dict(box(integrator="bdpt")), **options))
    cluster.add()
    cluster.wait(2)
    for found in djpt.apps.cluster.render_passes(cluster.client, box(integrator="bdpt"), **options):
        if found.rounds == 4:
            os.kill(cluster.workers[-1].pid, signal.SIGKILL)
            cluster.add()
        if found.rounds == 14:
            os.kill(cluster.workers[0].pid, signal.SIGTERM)
        if found.rounds == 24:
            cluster.add()
        if found.rounds == 30:
            for worker in cluster.workers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGKILL)
            cluster.add()
    assert found.rounds == 40
    assert np.array_equal(found.image().numpy(), expected.image().numpy())


@pytest.fixture
def fresh_cluster() -> Iterator[Cluster]:
    """A cluster without workers, whose workers may be stopped and killed."""
    with distributed.LocalCluster(
        n_workers=0, dashboard_address=None, protocol="tcp://", host="127.0.0.1"
    ) as scheduler:
        result = Cluster(scheduler)
        yield result
        for worker in result.workers:
            worker.kill()
            worker.wait()
        result.client.close()


@pytest.mark.slow
def test_a_stopped_worker_has_its_share_taken(fresh_cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker that is stopped keeps its connection, and the scheduler waits for it for minutes."""
    monkeypatch.setattr(rendering, "SILENCE", 4.0)
    options = {"spp": 160, "round_spp": 4, "seed": 3}
    expected = last(djpt.render_passes(djpt.load_dict(box(integrator="bdpt")), **options))
    stopped = fresh_cluster.add()
    fresh_cluster.wait(1)
    images = djpt.apps.cluster.render_passes(fresh_cluster.client, box(integrator="bdpt"), **options)
    next(images)
    other = fresh_cluster.add()
    fresh_cluster.wait(2)
    start = 0.0
    for found in images:
        if found.rounds == 10:
            # It alone has the scene, or rounds of its own.
            os.kill(stopped.pid, signal.SIGSTOP)
            start = time.monotonic()
        if found.rounds == 30:
            # The first one is back, and now the other one stops.
            os.kill(stopped.pid, signal.SIGCONT)
            os.kill(other.pid, signal.SIGSTOP)
    assert time.monotonic() - start < 60
    assert found.rounds == 40
    assert np.array_equal(found.image().numpy(), expected.image().numpy())


@pytest.mark.slow
def test_what_a_stopped_worker_has_found_is_found_again(
    fresh_cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its results are there, for the scheduler, but can't be fetched."""
    monkeypatch.setattr(rendering, "SILENCE", 4.0)
    options = {"spp": 32, "round_spp": 4, "seed": 5}
    expected = last(djpt.render_passes(djpt.load_dict(box()), **options))
    stopped = fresh_cluster.add()
    fresh_cluster.wait(1)
    images = djpt.apps.cluster.render_passes(fresh_cluster.client, box(), **options)
    next(images)
    time.sleep(3)  # the rounds ahead of their turn are done
    os.kill(stopped.pid, signal.SIGSTOP)
    fresh_cluster.add()
    fresh_cluster.wait(2)
    start = time.monotonic()
    found = last(images)
    assert time.monotonic() - start < 60
    assert np.array_equal(found.image().numpy(), expected.image().numpy())


def test_which_workers_are_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr(rendering.time, "monotonic", lambda: now)
    watch = rendering.Watch()
    for now in range(0, 30, 2):
        signs = {"moves": float(now), "stops": min(now, 8.0)}
        watch.look({address: {"last_seen": sign - 1e9} for address, sign in signs.items()})
        assert watch.live | watch.stopped == {"moves", "stops"}
        assert watch.stopped == ({"stops"} if now - 8 > rendering.SILENCE else set())
    assert watch.live == {"moves"}
    assert not watch.trusts(None) and not watch.trusts(frozenset({"moves", "stops"}))
    assert watch.trusts(frozenset({"moves"})) and watch.trusts(frozenset({"moves", "gone"}))
    assert not watch.trusts(frozenset({"gone"}))
    watch.look({"stops": {"last_seen": 1.0}})
    assert watch.live == {"stops"} and watch.trusts(None)


@pytest.mark.slow
def test_without_workers_it_says_so(fresh_cluster: Cluster) -> None:
    with pytest.warns(RuntimeWarning, match="there are no workers at tcp://"):
        images = djpt.apps.cluster.render_passes(
            fresh_cluster.client, box(), spp=4, on_wait=lambda text: (rendering.warn(text), fresh_cluster.add())[0]
        )
        assert last(images).spp == 4


def test_a_scheduler_that_says_nothing_is_told(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    silent, told = iter([True, True, False]), []
    ask = cluster.client.scheduler_info

    def late(n_workers: int) -> Any:
        if next(silent, False):
            time.sleep(1)
        return ask(n_workers=n_workers)

    monkeypatch.setattr(rendering, "SILENCE", 0.5)
    monkeypatch.setattr(cluster.client, "scheduler_info", late)
    images = djpt.apps.cluster.render_passes(cluster.client, box(), spp=8, round_spp=4, on_wait=told.append)
    assert last(images).spp == 8
    (text,) = told
    assert "doesn't answer" in text


@pytest.mark.slow
def test_a_scheduler_that_is_gone_is_told() -> None:
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, processes=True) as own:
        client = distributed.Client(own, timeout=2)
        images = djpt.apps.cluster.render_passes(client, box(), spp=400000, round_spp=4)
        next(images)
        own.close()
        with pytest.raises(RenderError, match="scheduler of the cluster is gone"):
            last(images)
        client.close()


def folders() -> set[str]:
    return {path.name for path in Path(tempfile.gettempdir()).glob("djpt-cluster-*")}


def painted(path: Path) -> dict[str, Any]:
    """A scene that names a file."""
    djpt.write(path, np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3))
    return {**box(), "white": {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": str(path)}}}


def test_files_of_bundles_are_ones_own_and_gone_in_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle, before = Bundle.of(painted(tmp_path / "paint.png")), folders()
    seen = []

    def load(description: Any) -> Any:
        folder = Path(description["white"]["reflectance"]["filename"]).parent
        seen.append((folder.stat().st_mode & 0o777, folder.stat().st_uid, [path.suffix for path in folder.iterdir()]))
        return load_dict(description)

    load_dict = djpt.load_dict
    monkeypatch.setattr(djpt, "load_dict", load)
    scene = bundle.loaded()
    assert seen == [(0o700, os.getuid(), [".png"])]
    assert folders() == before
    assert np.isfinite(djpt.render(scene, spp=1).numpy()).all()


def test_files_that_have_changed_on_their_way_are_refused(tmp_path: Path) -> None:
    bundle = Bundle.of(painted(tmp_path / "paint.png"))
    ((name, (stored, contents)),) = bundle.files.items()
    places = [(stored, contents + b"x"), ("0" * 32 + ".png", contents), ("../" + stored, contents)]
    for place, found in places:
        with pytest.raises(FileError, match="was corrupted in transit"):
            replace(bundle, files={name: (place, found)}).loaded()
    # Nobody is asked for what lies in a folder that everybody can write to.
    planted = Path(tempfile.gettempdir()) / f"djpt-cluster-{bundle.key}"
    planted.mkdir()
    try:
        (planted / stored).write_bytes(b"not what was packed")
        bundle.loaded()
    finally:
        shutil.rmtree(planted)


def test_files_travel(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    djpt.write(tmp_path / "paint.png", np.linspace(0, 1, 48, dtype=np.float32).reshape(4, 4, 3))
    scene = box()
    scene["white"] = {"type": "diffuse", "reflectance": {"type": "bitmap", "filename": "paint.png"}}
    monkeypatch.chdir(tmp_path)
    expected = last(djpt.render_passes(djpt.load_dict(scene), spp=4))
    bundle = Bundle.of(scene)
    assert {name: stored.endswith(".png") for name, (stored, _) in bundle.files.items()} == {"paint.png": True}
    images = djpt.apps.cluster.render_passes(cluster.client, scene, spp=4)
    (tmp_path / "paint.png").unlink()
    assert np.array_equal(last(images).image().numpy(), expected.image().numpy())


def two_views() -> dict[str, Any]:
    scene = box()
    scene["second"] = dict(
        scene["sensor"], to_world=djpt.ScalarTransform4f().look_at([0.5, 0, 3.5], [0, 0, 0], [0, 1, 0])
    )
    return scene


def brightness(image: Any, view: int) -> Any:
    return dr.mean(dr.square(image), axis=None)


@pytest.mark.slow
def test_gradients_are_sums_over_views(cluster: Cluster) -> None:
    key = "red.reflectance.value"
    value = np.array([[0.5], [0.1], [0.2]], np.float32)
    loss, found = djpt.apps.cluster.gradient(
        cluster.client, two_views(), {key: value}, brightness, [0, 1], spp=4, seed=9
    )
    scene = djpt.load_dict(two_views())
    params = djpt.traverse(scene)
    expected, total = np.zeros((3, 1)), 0.0
    for view in (0, 1):
        params[key] = djpt.Color3f([0.5, 0.1, 0.2])
        dr.enable_grad(params[key])
        params.update()
        result = brightness(djpt.render(scene, params, sensor=view, spp=4, seed=round_seed(9, view)), view)
        dr.backward(result)
        expected += np.array(dr.grad(params[key]), np.float64).reshape(3, 1)
        total += float(result.numpy().ravel()[0])
    assert np.isclose(loss, total, rtol=1e-6)
    assert np.allclose(found[key].reshape(3, 1), expected, rtol=1e-6)
    # The parameter is the scene's again.
    unchanged = last(djpt.apps.cluster.render_passes(cluster.client, two_views(), spp=4))
    assert np.array_equal(
        unchanged.image().numpy(), last(djpt.render_passes(djpt.load_dict(two_views()), spp=4)).image().numpy()
    )


@pytest.mark.slow
def test_errors_name_the_cause(cluster: Cluster) -> None:
    client = cluster.client
    with pytest.raises(BackendError, match=r"must be a distributed\.Client"):
        djpt.apps.cluster.render_passes("tcp://somewhere", box())
    with pytest.raises(RenderError, match="there is no sensor 3"):
        djpt.apps.cluster.render_passes(client, box(), sensor=3)
    with pytest.raises(RenderError, match="'seed'"):
        djpt.apps.cluster.render_passes(client, box(), seed=-1)
    with pytest.raises(SceneError, match="can't be sent"):
        djpt.apps.cluster.render_passes(client, {**box(), "extra": lambda: None})
    with pytest.raises(DjptError, match=r"on a worker: .*no\.such"):
        djpt.apps.cluster.gradient(client, box(), {"no.such": np.zeros(3)}, brightness, [0])
    with pytest.raises(ParameterError, match="found none"):
        djpt.apps.cluster.gradient(client, box(), {}, brightness, [0])
    with pytest.raises(RenderError, match="'views'"):
        djpt.apps.cluster.gradient(client, box(), {"no.such": np.zeros(3)}, brightness, [])


@pytest.mark.slow
def test_the_command_line(cluster: Cluster, tmp_path: Path) -> None:
    address = cluster.scheduler.scheduler_address
    small = ("cornell_box", "--width", "16", "--spp", "128", "-q", "--target-error", "1e-6")
    for name, options in (("here", ()), ("there", ("--cluster", address, "--preview", str(tmp_path / "now.png")))):
        code, _, err = run("render", *small, *options, "-o", str(tmp_path / f"{name}.exr"))
        assert code == 0, err
    assert np.array_equal(djpt.read(tmp_path / "here.exr").numpy(), djpt.read(tmp_path / "there.exr").numpy())
    assert djpt.read(tmp_path / "now.png").shape == (16, 16, 3)
    code, _, err = run("render", "cornell_box", "--cluster", address, "--adaptive")
    assert code == 2 and "--adaptive" in err
