"""The house keeps its plan: small circles of imports, few modules at the top, files of a page or some."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.kit.processes import ROOT

SUBPACKAGES = ("integrators", "materials", "scenes", "validation")
LARGEST_CIRCLE = 4
LONGEST_FILE = 600


def files() -> dict[str, Path]:
    """All modules of the package, by name."""
    found = {}
    for folder in ("djpt", *SUBPACKAGES):
        package = folder if folder == "djpt" else f"djpt.{folder}"
        for path in sorted((ROOT / folder).rglob("*.py")):
            inside = path.relative_to(ROOT / folder).with_suffix("").parts
            if folder == "djpt" and inside[0] in SUBPACKAGES:
                continue  # a link to the folder at the top
            if inside[-1] == "__init__":
                inside = inside[:-1]
            found[".".join((package, *inside))] = path
    return found


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """The modules of the package that a file imports anywhere: for types and inside functions, too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= {name if name in known else node.module for name in whole}
    return names & set(known)


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """The sets of more than one module that all import each other, directly or by way of others."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = [start]
        while waiting:
            fresh = graph[waiting.pop()] - seen
            seen |= fresh
            waiting += fresh
        return seen

    reach = {module: reached(module) for module in graph}
    found = {frozenset(m for m in reach[module] if module in reach[m]) for module in graph if module in reach[module]}
    return [set(circle) for circle in found if len(circle) > 1]


def test_circles_of_imports_are_small() -> None:
    known = files()
    graph = {name: imported(path, known) - {name} for name, path in known.items()}
    large = [sorted(circle) for circle in circles(graph) if len(circle) > LARGEST_CIRCLE]
    assert not large, large


def test_circles_are_found() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": {"d"}, "f": {"a"}}
    assert sorted(map(sorted, circles(graph))) == [["a", "b", "c"], ["d", "e"]]


def test_the_renderer_needs_no_names_for_scripts() -> None:
    """Only public modules at the top, the package of names `ad`, and the check of names may import `djpt.mitsuba`."""
    known = files()
    users = {
        name
        for name, path in known.items()
        if not name.startswith(("djpt.mitsuba", "djpt.ad.", "djpt.validation.names"))
        and any(module.startswith("djpt.mitsuba") for module in imported(path, known))
    }
    tops = {"djpt", *(f"djpt.{path.stem}" for path in (ROOT / "djpt").glob("*.py"))}
    needed = (
        "djpt.scene.scene",
        "djpt.core.records",
        "djpt.types",
        "djpt.rendering",
        "djpt.description.parameters",
        "djpt.core.transforms",
    )
    assert users <= tops - set(needed), users - tops


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


def test_every_folder_is_described() -> None:
    """The table of docs/architecture.md names all folders of the engine."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    folders = [path.name for path in (ROOT / "djpt").iterdir() if path.is_dir() and not path.is_symlink()]
    missing = [name for name in folders if name != "__pycache__" and f"`djpt/{name}/`" not in text]
    assert not missing, missing
