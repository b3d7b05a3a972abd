"""The server of the page: what it hands out, and whom it lets connect."""

import json
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from djpt.errors import RenderError
from djpt.viewer.server import Server


def test_it_serves_the_files_of_the_page_alone() -> None:
    with Server() as server:
        with urlopen(server.url) as answer:
            assert b"<canvas" in answer.read()
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
        with urlopen(server.url + "main.js") as answer:
            assert answer.headers["Content-Type"].startswith("text/javascript")
        for name in ("../session.py", "..%2fsession.py", "page/main.js", "nothing.html", "__init__.py", "%00.html"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(server.url + name)


@pytest.mark.parametrize("origin", [None, "http://example.org", "null"])
def test_other_pages_may_not_connect(origin: str | None) -> None:
    with Server() as server:
        address = server.url.replace("http", "ws") + "socket"
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin)  # type: ignore[arg-type]


def test_messages_and_frames() -> None:
    with Server() as server:
        address = server.url.replace("http", "ws") + "socket"
        with connect(address, origin=server.url.rstrip("/")) as page:  # type: ignore[arg-type]
            assert server.inbox.get(timeout=10) == {"do": "join"}
            page.send(json.dumps({"do": "home"}))
            assert server.inbox.get(timeout=10) == {"do": "home"}
            page.send("no JSON")
            assert "do" in server.inbox.get(timeout=10)
            page.send("[1]")
            assert "do" in server.inbox.get(timeout=10)
            server.tell({"error": "none"})
            assert json.loads(page.recv(timeout=10)) == {"error": "none"}
            server.publish(b"frame")
            assert page.recv(timeout=10) == b"frame"


def test_a_port_that_is_taken() -> None:
    with Server() as server:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        with pytest.raises(RenderError, match=f"can't listen at 127.0.0.1, port {port}"):
            Server(port)
