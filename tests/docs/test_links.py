"""Links between Markdown files lead somewhere, headings included, and no merge was left half done."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from tests.kit.processes import ROOT

LINK = re.compile(r"\]\(([^)\s]*)\)")
HEADING = re.compile(r"^#{1,6} +(.*?)\s*$", re.MULTILINE)
NAMED = re.compile(r"^\((\S+)\)=$", re.MULTILINE)
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
MARKERS = re.compile(rb"^(<{7}|>{7}|\|{7})( |$)|^={7}$", re.MULTILINE)


def tracked(pattern: str = "*") -> list[str]:
    """Files that git knows, links to folders left out; none in an unpacked archive."""
    try:
        done = subprocess.run(["git", "ls-files", "-z", pattern], cwd=ROOT, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return []
    return [name for name in done.stdout.decode().split("\0") if name and (ROOT / name).is_file()]


MARKDOWN = tracked("*.md")

pytestmark = pytest.mark.skipif(not MARKDOWN, reason="not a working copy of the repository")


def anchors(text: str) -> set[str]:
    """The anchors of headings, as GitHub and MyST write them, and those that have a name of their own."""
    prose = FENCED.sub("", text)
    words = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in HEADING.findall(prose)]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in words} | set(NAMED.findall(prose))


def dead_links(page: Path) -> list[str]:
    """Targets of a page that don't exist; names of the API are tested in test_pages.py."""
    text = FENCED.sub("", page.read_text())
    dead = []
    for target in LINK.findall(text):
        if target.startswith(("https://", "#djpt")):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if not file.exists() or (anchor and anchor not in anchors(file.read_text())):
            dead.append(target)
    return dead


@pytest.mark.parametrize("page", MARKDOWN)
def test_links_lead_somewhere(page: str) -> None:
    assert dead_links(ROOT / page) == []


def test_dead_links_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A heading, with `code`\n\n[a](#a-heading-with-code) [b](#b) [c](c.md) [d](page.md#d) [e](page.md)\n"
    )
    assert dead_links(page) == ["#b", "c.md", "page.md#d"]


def test_no_conflict_marker_is_left() -> None:
    assert [name for name in tracked() if MARKERS.search((ROOT / name).read_bytes())] == []


@pytest.mark.parametrize("line", [b"<<<<<<< HEAD", b"=======", b">>>>>>> branch", b"||||||| base"])
def test_conflict_markers_are_found(line: bytes) -> None:
    assert MARKERS.search(b"before\n" + line + b"\nafter\n")
