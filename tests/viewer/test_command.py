"""The command `djpt view` as a process: how it ends."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from websockets.sync.client import connect

from tests.viewer.test_server import connected_deaf


@contextlib.contextmanager
def viewing(*options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process, and the address of its page."""
    command = [sys.executable, "-m", "djpt", "view", "cornell_box", "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().split()[0]
        finally:
            process.kill()


@pytest.mark.parametrize("options", [("--width", "512", "--height", "512"), ("--width", "64", "--spp", "1")])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_ctrl_c_ends_it_though_a_page_has_stopped_reading(options: tuple[str, ...]) -> None:
    with viewing(*options) as (process, url):
        origin = url[: url.index("/", 7)]
        address = url.replace("http", "ws") + "socket"
        with connected_deaf(url, origin), connect(address, origin=origin, max_size=None) as page:  # type: ignore[arg-type]
            # Both have got pictures, if they want them.
            while isinstance(page.recv(timeout=120), str):
                pass
            time.sleep(2)
            start = time.monotonic()
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 130
            assert time.monotonic() - start < 3
        assert process.stderr is not None
        assert process.stderr.read() == "djpt: error: interrupted\n"
