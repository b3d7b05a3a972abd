"""The page of `djpt view`, as a browser shows it."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from djpt.apps.viewer.server import Server
from djpt.apps.viewer.session import Session
from places import IMAGES, LADDER, ROOT

sys.path.append(str(ROOT))  # for the browser of the tests

from tests.kit.browser import CHROMIUM, browsing

__all__ = ["view"]

SPP = 256


def view() -> None:
    """The page with a picture that is done, its pointer on a sphere."""
    if CHROMIUM is None:
        print("view.png stays as it is: there is no Chromium to show the page")
        return
    with tempfile.TemporaryDirectory() as folder, Server() as server, browsing(Path(folder), 1100, 640) as page:
        session = Session(lambda: LADDER["room"](600), 0, SPP, 0, server.publish, server.tell)
        page.open(server.url)
        while not page.run(f"Number(document.body.dataset.spp) >= {SPP}"):
            session.turn(server.inbox, patience=0.1)
        page.mouse("mouseMoved", 480, 420)
        (IMAGES / "view.png").write_bytes(page.screenshot())
