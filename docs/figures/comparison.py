"""The page of a comparison, as a browser shows it."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from djpt.validation import compare
from places import IMAGES, ROOT

sys.path.append(str(ROOT))  # for the browser of the tests

from tests.kit.browser import CHROMIUM, browsing

__all__ = ["comparison_page"]


def comparison_page() -> None:
    """The upper part of the report on the Cornell box, djpt against Mitsuba."""
    if CHROMIUM is None:
        print("comparison_page.png stays as it is: there is no Chromium to show the page")
        return
    with tempfile.TemporaryDirectory() as folder, browsing(Path(folder) / "profile", 1100, 880) as page:
        report = Path(folder) / "box.html"
        compare("cornell_box", spp=64, width=160, height=160, limits={"flip": 0.2}).write_page(report)
        page.open(report.as_uri())
        page.wait("document.body.dataset.ready == 'yes'")
        (IMAGES / "comparison_page.png").write_bytes(page.screenshot())
