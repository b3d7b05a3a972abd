"""The notebooks of the documentation run, show pictures, and are kept without results."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from djpt.apps.display import picture_of
from tests.kit.processes import ROOT

FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@dataclass(frozen=True)
class Cell:
    """A cell with code."""

    notebook: Path
    number: int
    code: str
    stored: dict[str, Any]
    """The cell as the file has it."""

    def run(self, names: dict[str, Any], small: tuple[str, str] = ("", "")) -> Any:
        """Execute the cell in the namespace `names`; the value of its last line if that is an expression.

        `small`: a text in the cell, and what replaces it.
        """
        tree = ast.parse(self.code.replace(*small) if small[0] else self.code)
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        where = f"{self.notebook.name}, cell {self.number}"
        exec(compile(tree, where, "exec", dont_inherit=True), names)
        if last is None:
            return None
        return eval(compile(ast.Expression(last.value), where, "eval", dont_inherit=True), names)


def cells(notebook: Path) -> Iterator[Cell]:
    """The cells with code, in order."""
    for number, cell in enumerate(json.loads(notebook.read_text())["cells"]):
        if cell["cell_type"] == "code":
            yield Cell(notebook, number, "".join(cell["source"]), cell)


def shows(value: Any) -> bool:
    """Whether a notebook shows a value as a picture."""
    if hasattr(value, "_repr_png_"):
        return value._repr_png_() is not None
    return hasattr(value, "shape") and hasattr(value, "array") and picture_of(value) is not None


pytestmark = pytest.mark.skipif(not NOTEBOOKS, reason="not a working copy of the repository")

LIBRARIES = {"against_mitsuba": ("mitsuba",), "pytorch_and_jax": ("torch", "jax")}
"""What notebooks need besides djpt: one of these."""


SMALL = {"relightable_body": ("SIZE, STEPS = 32, 30", "SIZE, STEPS = 16, 2")}
"""What is written otherwise where a notebook is to take less time; for such a one there is a test of its own."""


@pytest.mark.parametrize("notebook", [p for p in NOTEBOOKS if p.stem not in SMALL], ids=lambda path: path.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    libraries = LIBRARIES.get(notebook.stem, ())
    if libraries and not any(map(importlib.util.find_spec, libraries)):
        pytest.skip(f"needs {' or '.join(libraries)}")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    results = [cell.run(names) for cell in cells(notebook)]
    assert any(map(shows, results)), "no cell shows a picture"


@pytest.mark.parametrize("name", SMALL)
def test_a_small_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    stored = list(cells(FOLDER / f"{name}.ipynb"))
    assert sum(SMALL[name][0] in cell.code for cell in stored) == 1
    assert any(shows(cell.run(names, SMALL[name])) for cell in stored)


@pytest.mark.slow
def test_the_body_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in cells(FOLDER / "relightable_body.ipynb"):
        cell.run(names)
    assert names["errors"]["colour"] < 0.04 and names["errors"]["roughness"] < 0.13 and names["errors"]["normals"] < 8
    assert names["off"]["found"] < 0.25


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_results(notebook: Path) -> None:
    for cell in cells(notebook):
        assert cell.stored["outputs"] == [] and cell.stored["execution_count"] is None, f"cell {cell.number}"
        compile(cell.code, notebook.name, "exec")  # no magics: plain Python
    stored = json.loads(notebook.read_text())
    assert (stored["nbformat"], stored["nbformat_minor"]) == (4, 5)
    assert notebook.read_text() == json.dumps(stored, indent=1, ensure_ascii=False) + "\n"


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_djpt_is_imported_first(notebook: Path) -> None:
    """Dr.Jit, imported before djpt, opens an LLVM of its own, which may be too old."""
    code = "\n".join(cell.code for cell in cells(notebook))
    names = [name for name in re.findall(r"^(?:import|from) (\w+)", code, re.MULTILINE) if name in ("djpt", "drjit")]
    assert names[0] == "djpt"


def test_all_notebooks_are_listed() -> None:
    page = (ROOT / "docs" / "notebooks.md").read_text()
    assert [path.stem for path in NOTEBOOKS if f"notebooks/{path.name}" not in page] == []
