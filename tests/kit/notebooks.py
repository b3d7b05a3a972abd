"""Notebooks without Jupyter: their cells run in one namespace, and what they would show is looked at."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from djpt.apps.display import picture_of
from tests.kit.processes import ROOT

__all__ = ["NOTEBOOKS", "Cell", "cells", "shows"]

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

    def run(self, names: dict[str, Any]) -> Any:
        """Execute the cell in the namespace `names`; the value of its last line if that is an expression."""
        tree = ast.parse(self.code)
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
