"""Commands for clusters where nobody answers: they say so, and signals end them."""

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import drjit as dr
import pytest

from tests.kit.commands import run

distributed = pytest.importorskip("distributed")

IMPORTING = 10
"""Seconds that a process may take before it asks anybody, on a machine with other work."""


@pytest.fixture(autouse=True)
def threads_stay() -> Iterator[None]:
    """A worker sets the number of threads of its process, which here goes on with other tests."""
    count = dr.thread_count()
    yield
    dr.set_thread_count(count)


@contextlib.contextmanager
def silent() -> Iterator[str]:
    """The address of something that takes connections and says nothing, as a scheduler that is stopped."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@contextlib.contextmanager
def closed() -> Iterator[str]:
    """An address where nothing is."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
    yield address


def command(kind: str, address: str, folder: Path) -> list[str]:
    image = str(folder / "a.exr")
    render = ["render", "cornell_box", "--width", "16", "-o", image, "--cluster", address]
    return render if kind == "render" else ["worker", address, "--threads", "1"]


@pytest.mark.sparse(3)
@pytest.mark.parametrize("kind", ["render", "worker"])
@pytest.mark.parametrize("place", [closed, silent])
def test_without_a_scheduler_it_says_so(kind: str, place: object, tmp_path: Path) -> None:
    with place() as address:  # type: ignore[operator]
        start = time.monotonic()
        code, _, err = run(*command(kind, address, tmp_path))
        assert time.monotonic() - start < 10 + IMPORTING
    assert code == 2
    assert address in err.splitlines()[-1]


@pytest.mark.parametrize("kind", ["render", "worker"])
@pytest.mark.parametrize("address", ["", " ", "nonsense", "http://localhost:1"])
def test_addresses_that_are_none(kind: str, address: str, tmp_path: Path) -> None:
    code, _, err = run(*command(kind, address, tmp_path))
    assert code == 2
    assert err.splitlines()[-1].startswith("djpt: error: ")


@pytest.mark.sparse(3)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("kind", ["render", "worker"])
def test_signals_end_waiting_for_a_scheduler(kind: str, number: signal.Signals, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        arguments = [sys.executable, "-m", "djpt", *command(kind, address, tmp_path)]
        with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
            server.accept()  # it has come
            process.send_signal(number)
            start = time.monotonic()
            assert process.wait(30) == 128 + number
            assert time.monotonic() - start < 3


@pytest.mark.sparse(2)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_waiting_for_workers(number: signal.Signals, tmp_path: Path) -> None:
    with distributed.LocalCluster(n_workers=0, dashboard_address=None, protocol="tcp://", host="127.0.0.1") as cluster:
        address = cluster.scheduler_address
        arguments = [sys.executable, "-m", "djpt", *command("render", address, tmp_path)]
        with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
            assert process.stderr is not None
            line = process.stderr.readline()
            assert line.startswith(f"djpt: there are no workers at {address}")
            process.send_signal(number)
            start = time.monotonic()
            assert process.wait(30) == 128 + number
            assert time.monotonic() - start < 3
    assert not (tmp_path / "a.exr").exists()
