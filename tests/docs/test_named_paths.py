"""Pages name files, modules and objects as they are in the tree; the changelog names them as they were."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path

import pytest

from djpt.core.former_paths import present_path
from tests.docs.test_links import MARKDOWN, tracked
from tests.kit.documents import figures, walks
from tests.kit.processes import ROOT

PATH = re.compile(r"(?<![\w/.-])(?:djpt|integrators|materials|scenes|validation|tests|benchmarks|examples)/[\w./-]*")
FILE = re.compile(r"`(\w+\.py)`")
NAME = re.compile(r"(?<![\w/.-])djpt(?:\.[a-zA-Z_]\w*)+")
INCLUDED = re.compile(r"\{(?:literal)?include\} (\S+)")
LISTING = re.compile(r"\{literalinclude\} (\S+)\n((?::[\w-]+:.*\n)*)")
TABLE = re.compile(r"^\.\. autosummary::\n\n((?:   \S+\n)+)", re.MULTILINE)

PAGES = [name for name in [*MARKDOWN, *tracked("*.ipynb")] if name != "CHANGELOG.md"]
FILES = {Path(name).name for name in tracked("*.py")}

ROOMS_OF_CHAPTERS = {
    "bitmaps": {"images"},
    "dispatch": {"dispatch", "distributions"},
    "fresnel": {"materials"},
    "ground": {"core", "jit"},
    "plugins": {"description"},
    "sensors": {"sensors", "films", "rfilters", "samplers"},
    "transforms": {"core"},
}
"""The rooms of a chapter of the reference that hasn't the name of its one."""

GROUPS = {"djpt.plugins"}
"""Groups of entry points, which are no modules."""

pytestmark = pytest.mark.skipif(not PAGES, reason="not a working copy of the repository")


def wrong_names(page: Path) -> list[str]:
    """What a page names that isn't there, but for what a walk of CONTRIBUTING.md makes."""
    text = page.read_text()
    made = walks() if page.name == "CONTRIBUTING.md" else []
    paths = {found.rstrip(".") for found in PATH.findall(text)} - {walk.path for walk in made}
    included = {found for found in INCLUDED.findall(text) if not (page.parent / found).exists()}
    names = {name for name in NAME.findall(text) if not any(walk.makes(name) for walk in made)}
    return sorted(
        {path for path in paths if not (ROOT / path).exists()}
        | {name for name in FILE.findall(text) if name not in FILES}
        | {name for name in names - GROUPS if not exists(name)}
        | included
    )


def exists(name: str) -> bool:
    """Whether there is a module or an object of that full name."""
    try:
        pkgutil.resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


@pytest.mark.parametrize("page", PAGES)
def test_pages_name_what_there_is(page: str) -> None:
    assert wrong_names(ROOT / page) == []


def test_wrong_names_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "`djpt/scene/scene.py`, djpt/scene/house.py. `scene.py` `house.py`\n"
        "djpt.scene.scene.Scene, djpt.types.Float, `djpt.house`, djpt.Scene.nothing\n"
        "```{literalinclude} house.py\n```\n"
    )
    assert wrong_names(page) == ["djpt.Scene.nothing", "djpt.house", "djpt/scene/house.py", "house.py"]


def test_chapters_of_the_reference_are_rooms() -> None:
    """Each module that is listed is in one chapter only, that of its room, by its present name."""
    room = figures("imports").room
    listed: list[str] = []
    for chapter in (ROOT / "docs" / "api").glob("*.md"):
        modules = [name for table in TABLE.findall(chapter.read_text()) for name in table.split()]
        assert {room(name) for name in modules} <= ROOMS_OF_CHAPTERS.get(chapter.stem, {chapter.stem})
        listed += modules
    assert len(listed) > 300
    assert len(set(listed)) == len(listed)
    assert [name for name in listed if present_path(name)] == []


@pytest.mark.parametrize("page", [name for name in PAGES if name.endswith(".md")])
def test_listings_show_what_there_is(page: str) -> None:
    """Objects and lines that a listing begins or ends at are in its file."""
    for file, options in LISTING.findall((ROOT / page).read_text()):
        source = ((ROOT / page).parent / file).read_text()
        for option, value in re.findall(r"^:([\w-]+): (.+)$", options, re.MULTILINE):
            if option == "pyobject":
                assert re.search(rf"^ *(def|class) {value.rpartition('.')[2]}\b", source, re.MULTILINE), (file, value)
                assert all(re.search(rf"^class {name}\b", source, re.MULTILINE) for name in value.split(".")[:-1]), (
                    value
                )
            elif option in ("start-at", "start-after", "end-at", "end-before"):
                assert value.strip('"') in source, (file, value)
