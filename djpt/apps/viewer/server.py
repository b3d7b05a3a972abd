"""The local server of the page: its files over HTTP, frames and messages over a WebSocket.

The address of the page begins with a secret: requests without it are refused. This keeps out other users of the
machine, others on its network, and foreign pages in the user's browser, even if their host name has been made to
resolve to this machine (DNS rebinding).
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import queue
import secrets
import socket
import threading
from collections.abc import Mapping
from http import HTTPStatus
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

from djpt.apps.viewer.controls import parsed
from djpt.core.files import reason
from djpt.errors import BackendError, RenderError

__all__ = ["Server"]

KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
"""The media types of the page's files, by extension."""

LARGEST_MESSAGE = 2**16
"""The maximum size of a message from a page, in bytes."""


WAITING = 1000
"""The number of messages from pages that may be queued; pages that send more have to wait."""

SECRET_BYTES = 16
"""Random bytes in the address of the page."""

GRACE = 1.0
"""Seconds that pages have to disconnect at shutdown; then their connections are cut."""


class Outbox:
    """Pending output for one page: the newest message of each kind, and the newest frame, so that slow pages skip some.

    Messages are of one kind if they have the same keys. So the outbox of a page that doesn't read is bounded.
    """

    def __init__(self) -> None:
        self._filled = threading.Condition()
        self._messages: dict[frozenset[str], str] = {}
        self._frame: bytes | None = None
        self._closed = False

    def put(self, item: Mapping[str, Any] | bytes) -> None:
        """Add a message, or replace the frame."""
        with self._filled:
            if isinstance(item, bytes):
                self._frame = item
            else:
                kind = frozenset(item)
                self._messages.pop(kind, None)  # the newest stands last
                self._messages[kind] = json.dumps(item)
            self._filled.notify()

    def close(self) -> None:
        """End `take`."""
        with self._filled:
            self._closed = True
            self._filled.notify()

    def take(self) -> list[str | bytes]:
        """Wait for output; empty if the outbox is closed."""
        with self._filled:
            self._filled.wait_for(lambda: self._messages or self._frame is not None or self._closed)
            if self._closed:
                return []
            items: list[str | bytes] = [*self._messages.values(), *([] if self._frame is None else [self._frame])]
            self._messages, self._frame = {}, None
            return items


class Server:
    """Serves the page on a port of this machine. Used in a ``with`` statement; runs in threads of its own.

    The page and its connection are below ``/SECRET/``, with a secret of 128 bits that each server draws. At an address
    of the machine itself (loopback), the name that a browser asked for must be one of the machine itself, too. A
    connection must come from a page of this server.

    Args:
        port: the TCP port; 0 takes a free one.
        host: the address to listen at. Anyone who knows the address of the page can view it and change parameters.

    Raises:
        BackendError: The package `websockets` is missing.
        RenderError: The port is taken, or there is no such address.
    """

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        try:
            from websockets.sync.server import ServerConnection, serve
        except ImportError:
            raise BackendError("the page needs the package 'websockets': pip install websockets") from None
        self.inbox: queue.Queue[dict[str, Any]] = queue.Queue(WAITING)
        """Messages of pages; ``{"do": "join"}`` when one has connected."""
        self._secret = secrets.token_urlsafe(SECRET_BYTES)
        self._page = {
            file.name: file.read_bytes()
            for file in resources.files("djpt.apps.viewer").joinpath("page").iterdir()
            if file.name.rpartition(".")[2] in KINDS
        }
        """The files of the page, by their names: names in requests never reach the file system."""
        self._outboxes: set[Outbox] = set()
        self._connections: set[socket.socket] = set()
        """The open connections, from their first byte on."""
        self._ending = threading.Event()
        self._lock = threading.Lock()

        def connected(own: socket.socket, *arguments: Any, **options: Any) -> Any:
            with self._lock:
                self._connections = {known for known in self._connections if known.fileno() >= 0} | {own}
            return ServerConnection(own, *arguments, **options)

        listening = listening_at(host, port)
        # Frames are noise: compressing them costs more than sending them.
        self._server: Any = serve(
            self._talk,
            sock=listening,
            process_request=self._answer,
            compression=None,
            max_size=LARGEST_MESSAGE,
            create_connection=connected,  # type: ignore[arg-type]
            logger=logging.Logger("djpt.apps.viewer", logging.CRITICAL + 1),  # strangers' requests are no news
        )
        bound, number = listening.getsockname()[:2]
        self._own_names = names_of_loopback(bound, host)
        shown = "127.0.0.1" if bound == "0.0.0.0" else "::1" if bound == "::" else host
        self.origin = f"http://{f'[{shown}]' if ':' in shown else shown}:{number}"
        """The `Origin` that browsers send for a page of this server."""
        self.url = f"{self.origin}/{self._secret}/"
        """The address of the page."""
        self._thread = threading.Thread(target=self._server.serve_forever, name="djpt-view", daemon=True)

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ending.set()
        with self._lock:
            for outbox in self._outboxes:
                outbox.close()
        # Waits for all pages; but one may have stopped reading.
        leaving = threading.Thread(target=self._server.shutdown, daemon=True)
        leaving.start()
        leaving.join(GRACE)
        with self._lock:
            for connection in self._connections:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
        leaving.join(GRACE)
        self._thread.join(GRACE)

    def publish(self, item: Mapping[str, Any] | bytes) -> None:
        """Send a message or a frame to all pages; a newer one of its kind may overtake it."""
        with self._lock:
            for outbox in self._outboxes:
                outbox.put(item)

    # ---- in the server's threads ---------------------------------------------------------------

    def _answer(self, connection: Any, request: Any) -> Any:
        """Answer a request for a file of the page; None lets the WebSocket open."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        host = request.headers.get_all("Host")
        if self._own_names and (len(host) != 1 or name_in(host[0]) not in self._own_names):
            return connection.respond(HTTPStatus.FORBIDDEN, "wrong host name for this server\n")
        secret, _, name = request.path.partition("?")[0].removeprefix("/").partition("/")
        if not secrets.compare_digest(secret.encode(errors="replace"), self._secret.encode()):
            return connection.respond(
                HTTPStatus.FORBIDDEN, "the secret is missing: open the address that djpt view has printed\n"
            )
        if name == "socket":
            origins = request.headers.get_all("Origin")
            if len(host) != 1 or origins not in ([f"http://{host[0]}"], [f"https://{host[0]}"]):
                return connection.respond(HTTPStatus.FORBIDDEN, "only this server's page may connect\n")
            return None
        name = name or "index.html"
        body = self._page.get(name)
        if body is None:
            return connection.respond(HTTPStatus.NOT_FOUND, "no such file\n")
        headers = {
            "Content-Type": f"{KINDS[name.rpartition('.')[2]]}; charset=utf-8",
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
            "Connection": "close",
        }
        return Response(HTTPStatus.OK.value, HTTPStatus.OK.phrase, Headers(headers), body)

    def _talk(self, connection: Any) -> None:
        """Serve one page until it disconnects."""
        from websockets.exceptions import ConnectionClosed

        outbox = Outbox()
        with self._lock:
            self._outboxes.add(outbox)
        sender = threading.Thread(target=deliver, args=(connection, outbox), daemon=True)
        sender.start()
        try:
            self._hand_on({"do": "join"})
            for text in connection:
                self._hand_on(parsed(text))
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._outboxes.discard(outbox)
            outbox.close()

    def _hand_on(self, message: dict[str, Any]) -> None:
        """Put a message into the inbox, once there is room."""
        while not self._ending.is_set():
            with contextlib.suppress(queue.Full):
                return self.inbox.put(message, timeout=0.1)


def deliver(connection: Any, outbox: Outbox) -> None:
    """Send the items of an outbox until it is closed or the page has disconnected."""
    from websockets.exceptions import ConnectionClosed

    try:
        while items := outbox.take():
            for item in items:
                connection.send(item)
    except ConnectionClosed:
        pass
    connection.close()


# ---- addresses -------------------------------------------------------------------------------


def listening_at(host: str, port: int) -> socket.socket:
    """A socket that listens; raises `RenderError` if it can't."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return socket.create_server(address[:2], family=family)
    except (OSError, UnicodeError) as error:
        raise RenderError(f"can't listen at {host}, port {port}: {reason(error)}") from None


def names_of_loopback(bound: str, host: str) -> frozenset[str]:
    """The names by which browsers may ask for a server that listens at an address of the machine itself.

    Empty if it listens elsewhere: a machine may have names that it doesn't know.
    """
    if not ipaddress.ip_address(bound.partition("%")[0]).is_loopback:
        return frozenset()
    return frozenset({"localhost", "127.0.0.1", "::1", bound, host.lower()})


def name_in(host: str) -> str | None:
    """The name in a header ``Host``, which may have a port, in lower case; None if there is none."""
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
