"""The house keeps its plan: small circles of imports, few modules at the top, files of a page or some."""

from __future__ import annotations

import pkgutil
import re
from typing import Any

import pytest

from tests.kit.documents import figures
from tests.kit.processes import ROOT

SUBPACKAGES = ("integrators", "materials", "scenes", "validation")
LARGEST_CIRCLE = 4
MOST_MUTUAL_PAIRS = 6
MOST_ROOMS = 32
LONGEST_FILE = 600

PAGE = ROOT / "docs" / "architecture.md"

Graph = dict[str, set[str]]


@pytest.fixture(scope="module")
def reading() -> Any:
    """What reads imports, shared with the picture of the house."""
    return figures("imports")


@pytest.fixture(scope="module")
def graph(reading: Any) -> Graph:
    found: Graph = reading.imports({name: path.read_text() for name, path in reading.modules(ROOT).items()})
    assert len(found) > 500
    return found


@pytest.fixture(scope="module")
def rooms(reading: Any, graph: Graph) -> Graph:
    found: Graph = reading.rooms(graph)
    return found


def test_circles_of_imports_are_small(reading: Any, graph: Graph) -> None:
    large = [circle for circle in reading.circles(graph) if len(circle) > LARGEST_CIRCLE]
    assert not large, large


def test_few_rooms_import_each_other(rooms: Graph) -> None:
    mutual = sorted((a, b) for a in rooms for b in rooms[a] if a < b and a in rooms[b])
    assert len(mutual) <= MOST_MUTUAL_PAIRS, mutual
    assert len(rooms) <= MOST_ROOMS, sorted(rooms)


def test_circles_are_found(reading: Any) -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": {"d"}, "f": {"a"}}
    assert reading.circles(graph) == [["a", "b", "c"], ["d", "e"]]


def test_every_way_to_import_counts(reading: Any) -> None:
    """For types, inside functions, by a string, and through packages that hand names on."""
    sources = {
        "djpt": "",
        "djpt.shapes": "from djpt.shapes.mesh import Mesh as Mesh\nfrom djpt.shapes.ball import Ball as Sphere",
        "djpt.shapes.mesh": "class Mesh: pass",
        "djpt.shapes.ball": "class Ball: pass",
        "djpt.scene": "if TYPE_CHECKING:\n    from djpt.shapes import Mesh",
        "djpt.films": "def f():\n    from djpt.shapes import Sphere",
        "djpt.media": "importlib.import_module('djpt.shapes.mesh')\nimport djpt",
        "djpt.phase": "from djpt import shapes\nimport djpt.media",
    }
    found = reading.imports(sources)
    assert {name: found[name] for name in ("djpt.scene", "djpt.films", "djpt.media", "djpt.phase")} == {
        "djpt.scene": {"djpt.shapes.mesh"},
        "djpt.films": {"djpt.shapes.ball"},
        "djpt.media": {"djpt.shapes.mesh"},
        "djpt.phase": {"djpt.shapes", "djpt.media"},
    }
    assert reading.rooms(found)["phase"] == {"shapes", "media"}


def test_the_renderer_needs_no_names_for_scripts(graph: Graph) -> None:
    """Only the public names and the check of names may import `djpt.mitsuba`."""
    users = {
        name
        for name, targets in graph.items()
        if not name.startswith(("djpt.mitsuba", "djpt.validation.names"))
        and any(module.startswith("djpt.mitsuba") for module in targets)
    }
    assert users <= {"djpt"}, users


def test_the_top_of_the_package_is_small() -> None:
    assert len(list((ROOT / "djpt").glob("*.py"))) <= 20


@pytest.mark.parametrize("folder", ["djpt", *SUBPACKAGES])
def test_files_are_short(folder: str) -> None:
    long = {
        str(path.relative_to(ROOT)): lines
        for path in (ROOT / folder).rglob("*.py")
        if (lines := path.read_text().count("\n")) > LONGEST_FILE
    }
    assert not long, long


def test_every_folder_is_described(rooms: Graph) -> None:
    """The tables of docs/architecture.md have a row for each room and no other, and the picture a box."""
    folders = {f"djpt/{path.name}/" for path in (ROOT / "djpt").iterdir() if path.is_dir() and path.name in rooms}
    folders = {folder.removeprefix("djpt/") if folder[5:-1] in SUBPACKAGES else folder for folder in folders}
    files = {f"djpt/{path.name}" for path in (ROOT / "djpt").glob("*.py")}
    described = re.findall(r"^\| `([\w/.]+)` \|", PAGE.read_text(), re.MULTILINE)
    assert sorted(described) == sorted(folders | files)
    assert len(described) == len(rooms)
    assert sorted(figures("house").ORDER) == sorted(rooms)


def test_imports_go_down(rooms: Graph) -> None:
    """All but those that docs/architecture.md lists, with the reason of each."""
    listed = set(re.findall(r"^\| `(\w+)` to `(\w+)` \|", PAGE.read_text(), re.MULTILINE))
    found = set(figures("house").upward(rooms))
    assert found and found <= listed, found - listed


def test_the_picture_of_the_house_is_current(rooms: Graph) -> None:
    """Else: python docs/figures house."""
    picture = figures("house")
    assert (ROOT / "docs" / "images" / "house.svg").read_text(encoding="utf-8") == picture.drawn(rooms)
    fewer = {name: targets - {"rendering"} for name, targets in rooms.items()}
    assert picture.drawn(fewer) != picture.drawn(rooms)


@pytest.mark.parametrize("name", ["ray_query", "gradient"])
def test_the_pictures_of_calls_are_current(name: str) -> None:
    """What they name exists. Else: python docs/figures ray_query gradient."""
    chains = figures("chains")
    calls = [step.call for row in chains.CHAINS[name][1] for step in row if step is not None and step.call]
    for call in calls:
        pkgutil.resolve_name(call)
    assert len(calls) > 5
    assert (ROOT / "docs" / "images" / f"{name}.svg").read_text(encoding="utf-8") == chains.drawn(name)
