"""The server of the page: what it hands out, and whom it lets connect."""

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from djpt.apps.viewer.server import Server
from djpt.errors import RenderError


def asked(server: Server, path: str, host: str | None, **headers: str) -> int:
    """The status of the answer to a request with any headers."""
    address = urlsplit(server.url)
    lines = [f"GET {path} HTTP/1.1", *([] if host is None else [f"Host: {host}"])]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    with socket.create_connection((address.hostname, address.port), timeout=10) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        return int(connection.recv(4096).split()[1])


def secret_of(server: Server) -> str:
    return urlsplit(server.url).path


@contextlib.contextmanager
def page_of(server: Server) -> Iterator[ClientConnection]:
    address = server.url.replace("http", "ws") + "socket"
    with connect(address, origin=server.origin, close_timeout=0.5) as page:  # type: ignore[arg-type]
        assert server.inbox.get(timeout=10) == {"do": "join"}
        yield page


def test_it_serves_the_files_of_the_page_alone() -> None:
    with Server() as server:
        with urlopen(server.url) as answer:
            assert b"<canvas" in answer.read()
            assert answer.headers["Content-Type"] == "text/html; charset=utf-8"
            assert answer.headers["Referrer-Policy"] == "no-referrer"
        with urlopen(server.url + "main.js") as answer:
            assert answer.headers["Content-Type"].startswith("text/javascript")
        for name in ("../session.py", "..%2fsession.py", "page/main.js", "nothing.html", "__init__.py", "%00.html"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(server.url + name)


def test_names_of_any_length_are_answered(capfd: pytest.CaptureFixture[str]) -> None:
    with Server() as server:
        for name in ("x" * 4000, "x" * 4000 + ".js", "a/" * 2000 + "main.js"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(server.url + name)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("origin", [None, "http://example.org", "null"])
def test_other_pages_may_not_connect(origin: str | None) -> None:
    with Server() as server:
        address = server.url.replace("http", "ws") + "socket"
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin=origin)  # type: ignore[arg-type]


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
@pytest.mark.parametrize("name", ["", "index.html", "main.js", "socket"])
def test_who_doesnt_know_the_secret_gets_nothing(name: str, host: str) -> None:
    """A page of a stranger whose name has become 127.0.0.1 asks with a host and an origin that agree."""
    with Server(host=host) as server:
        port = urlsplit(server.url).port
        for other in (f"127.0.0.1:{port}", f"evil.example:{port}"):
            upgrade = {
                "Origin": f"http://{other}",
                "Connection": "Upgrade",
                "Upgrade": "websocket",
                "Sec_WebSocket_Version": "13",
                "Sec_WebSocket_Key": "AAAAAAAAAAAAAAAAAAAAAA==",
            }
            for path in (f"/{name}", f"/{'x' * 22}/{name}", f"//{name}", secret_of(server)[:-2] + f"/{name}"):
                assert asked(server, path, other, **upgrade) == 403, path
        assert asked(server, secret_of(server) + name, f"127.0.0.1:{port}", **upgrade) in (101, 200) or name == "socket"


def test_addresses_of_the_machine_itself_have_its_names() -> None:
    with Server() as server:
        port = urlsplit(server.url).port
        for own in (f"127.0.0.1:{port}", f"localhost:{port}", f"LOCALHOST:{port}", f"[::1]:{port}", "localhost:9000"):
            assert asked(server, secret_of(server), own) == 200, own
        foreign = (
            f"evil.example:{port}",
            "evil.example",
            f"127.0.0.1.evil.example:{port}",
            f"10.0.0.1:{port}",
            "[",
            "",
        )
        for other in (*foreign, None):
            assert asked(server, secret_of(server), other) == 403, other


def test_other_addresses_have_any_name() -> None:
    """The names of a machine, and of ways to it, aren't known: there the secret decides alone."""
    with Server(host="0.0.0.0") as server:
        assert asked(server, secret_of(server), "render-box.example:8642") == 200
        assert server.url.startswith("http://127.0.0.1:")


def test_secrets_differ() -> None:
    with Server() as one, Server() as other:
        assert secret_of(one) != secret_of(other)
        assert len(secret_of(one)) >= 22


def test_messages_and_frames() -> None:
    with Server() as server, page_of(server) as page:
        page.send(json.dumps({"do": "home"}))
        assert server.inbox.get(timeout=10) == {"do": "home"}
        for text in ("no JSON", "[1]", "[" * 60000, '{"do": ' + "[" * 60000, "9" * 60000, "\0", "NaN"):
            page.send(text)
            assert "do" in server.inbox.get(timeout=10), text[:20]
        page.send(b"\xff\xfe\x00")
        assert "do" in server.inbox.get(timeout=10)
        server.publish({"error": "none"})
        assert json.loads(page.recv(timeout=10)) == {"error": "none"}
        server.publish(b"frame")
        assert page.recv(timeout=10) == b"frame"


def connected_deaf(url: str, origin: str) -> socket.socket:
    """A page that is connected, and doesn't read."""
    address = urlsplit(url)
    upgrade = (
        f"GET {address.path}socket HTTP/1.1\r\nHost: {address.netloc}\r\nOrigin: {origin}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    page = socket.create_connection((address.hostname, address.port))
    page.sendall(upgrade.encode())
    return page


@contextlib.contextmanager
def deaf_page_of(server: Server) -> Iterator[socket.socket]:
    """A page that has been sent more than it reads, so that the server's sender waits."""
    with connected_deaf(server.url, server.origin) as page:
        assert server.inbox.get(timeout=10) == {"do": "join"}
        for _ in range(20):
            server.publish(bytes(1 << 22))
            time.sleep(0.02)
        yield page


def test_what_a_page_hasnt_read_is_bounded() -> None:
    with Server() as server, deaf_page_of(server):
        for number in range(1000):
            server.publish({"error": f"{number}"})
            server.publish({"layers": [], "number": number})
            server.publish(bytes(1 << 16))
        (outbox,) = server._outboxes
        assert outbox.take() == ['{"error": "999"}', '{"layers": [], "number": 999}', bytes(1 << 16)]


def test_it_ends_while_a_page_doesnt_read_and_another_says_nothing() -> None:
    with contextlib.ExitStack() as pages:
        with Server() as server:
            address = urlsplit(server.url)
            pages.enter_context(socket.create_connection((address.hostname, address.port)))
            pages.enter_context(deaf_page_of(server))
            start = time.monotonic()
        assert time.monotonic() - start < 3
        # Python waits for such threads in the end.
        left = [thread for thread in threading.enumerate() if not thread.daemon]
        assert left == [threading.main_thread()]


def test_a_page_that_sends_without_end_has_to_wait() -> None:
    with Server() as server, page_of(server) as page:
        text = json.dumps({"do": "home", "fill": "x" * 10000})

        def send() -> None:
            with contextlib.suppress(Exception):
                for _ in range(20000):
                    page.send(text)

        sending = threading.Thread(target=send, daemon=True)
        sending.start()
        time.sleep(3)
        assert server.inbox.qsize() <= 1000
        assert sending.is_alive()
        page.socket.shutdown(socket.SHUT_RDWR)


def test_addresses_that_cant_be_had() -> None:
    with Server() as server:
        port = urlsplit(server.url).port
        assert port is not None
        with pytest.raises(RenderError, match=f"can't listen at 127.0.0.1, port {port}"):
            Server(port)
    with pytest.raises(RenderError, match=r"can't listen at no\.such\.host\.invalid"):
        Server(host="no.such.host.invalid")
    with pytest.raises(RenderError, match="can't listen"):
        Server(host="x" * 300)
