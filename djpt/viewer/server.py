"""The local server of the page: its files over HTTP, frames and messages over a WebSocket."""

from __future__ import annotations

import json
import queue
import threading
from http import HTTPStatus
from importlib import resources
from typing import Any

from djpt.errors import BackendError, RenderError
from djpt.files import reason

__all__ = ["Server"]

KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
"""The files of the page, by the ends of their names."""

LARGEST_MESSAGE = 2**16
"""Bytes of a message from a page."""


class Outbox:
    """What one page is to be sent: all messages, and the newest frame, so that slow pages skip some."""

    def __init__(self) -> None:
        self._filled = threading.Condition()
        self._messages: list[str] = []
        self._frame: bytes | None = None
        self._closed = False

    def put(self, item: str | bytes) -> None:
        """Add a message (text) or replace the frame (bytes)."""
        with self._filled:
            if isinstance(item, bytes):
                self._frame = item
            else:
                self._messages.append(item)
            self._filled.notify()

    def close(self) -> None:
        """End `take`."""
        with self._filled:
            self._closed = True
            self._filled.notify()

    def take(self) -> list[str | bytes]:
        """Wait for something to be sent; nothing if the outbox is closed."""
        with self._filled:
            self._filled.wait_for(lambda: self._messages or self._frame is not None or self._closed)
            if self._closed:
                return []
            items: list[str | bytes] = [*self._messages, *([] if self._frame is None else [self._frame])]
            self._messages, self._frame = [], None
            return items


class Server:
    """Serves the page on a port of this machine. Used in a ``with`` statement; runs in threads of its own.

    Only pages that this server has sent may connect: others are refused by their origin.

    Args:
        port: the TCP port; 0 takes a free one.
        host: the address to listen at. Whoever can reach it can look and change parameters.

    Raises:
        BackendError: The package `websockets` is missing.
        RenderError: The port is taken.
    """

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        try:
            from websockets.sync.server import serve
        except ImportError:
            raise BackendError("the page needs the package 'websockets': pip install websockets") from None
        self.inbox: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        """Messages of pages; ``{"do": "join"}`` when one has connected."""
        self._outboxes: set[Outbox] = set()
        self._lock = threading.Lock()
        try:
            # Frames are noise: compressing them costs more than sending them.
            self._server = serve(
                self._talk, host, port, process_request=self._answer, compression=None, max_size=LARGEST_MESSAGE
            )
        except OSError as error:
            raise RenderError(f"can't listen at {host}, port {port}: {reason(error)}") from None
        self.url = f"http://{host}:{self._server.socket.getsockname()[1]}/"
        """The address of the page."""
        self._thread = threading.Thread(target=self._server.serve_forever, name="djpt-view", daemon=True)

    def __enter__(self) -> Server:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        with self._lock:
            for outbox in self._outboxes:
                outbox.close()
        self._server.shutdown()
        self._thread.join(5)

    @property
    def has_pages(self) -> bool:
        """Whether a page is connected."""
        with self._lock:
            return bool(self._outboxes)

    def publish(self, frame: bytes) -> None:
        """Send a frame to all pages, unless a newer one overtakes it."""
        self._send(frame)

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to all pages."""
        self._send(json.dumps(message))

    def _send(self, item: str | bytes) -> None:
        with self._lock:
            for outbox in self._outboxes:
                outbox.put(item)

    # ---- in the server's threads ---------------------------------------------------------------

    def _answer(self, connection: Any, request: Any) -> Any:
        """Answer a request for a file of the page; None lets the WebSocket open."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        name = request.path.partition("?")[0].lstrip("/") or "index.html"
        if name == "socket":
            own = request.headers.get("Host", "")
            if request.headers.get("Origin") not in (f"http://{own}", f"https://{own}"):
                return connection.respond(HTTPStatus.FORBIDDEN, "only the page of this server may connect\n")
            return None
        kind = KINDS.get(name.rpartition(".")[2])
        file = resources.files("djpt.viewer").joinpath("page", name)
        if "/" in name or kind is None or not file.is_file():
            return connection.respond(HTTPStatus.NOT_FOUND, "no such file\n")
        body = file.read_bytes()
        headers = {
            "Content-Type": f"{kind}; charset=utf-8",
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Connection": "close",
        }
        return Response(HTTPStatus.OK.value, HTTPStatus.OK.phrase, Headers(headers), body)

    def _talk(self, connection: Any) -> None:
        """Serve one page until it leaves."""
        from websockets.exceptions import ConnectionClosed

        outbox = Outbox()
        with self._lock:
            self._outboxes.add(outbox)
        sender = threading.Thread(target=deliver, args=(connection, outbox), daemon=True)
        sender.start()
        self.inbox.put({"do": "join"})
        try:
            for text in connection:
                self.inbox.put(parsed(text))
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._outboxes.discard(outbox)
            outbox.close()


def deliver(connection: Any, outbox: Outbox) -> None:
    """Send what comes into an outbox until it is closed or the page has left."""
    from websockets.exceptions import ConnectionClosed

    try:
        while items := outbox.take():
            for item in items:
                connection.send(item)
    except ConnectionClosed:
        pass
    connection.close()


def parsed(text: str | bytes) -> dict[str, Any]:
    """The message of a page; one that isn't a JSON object asks for nothing that exists."""
    try:
        message = json.loads(text)
    except ValueError:
        message = None
    return message if isinstance(message, dict) else {"do": "something that isn't a message"}
