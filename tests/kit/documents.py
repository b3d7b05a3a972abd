"""The code of the project's pages: Markdown's blocks, CONTRIBUTING's walks, the scripts of figures."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.kit.processes import ROOT

__all__ = ["Snippet", "Walk", "figures", "sections", "snippets", "walks"]


FOLDER = ROOT / "docs" / "figures"


def figures(name: str) -> ModuleType:
    """A module of docs/figures, which import each other by their short names."""
    if not FOLDER.is_dir():
        pytest.skip("not a working copy of the repository")
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    return importlib.import_module(name)


CONSTANTS = re.compile(r"^([A-Z_]+(?:, [A-Z_]+)*) = (\d+(?:, \d+)*)$", re.MULTILINE)
HEADING = re.compile(r"^## (.*)$", re.MULTILINE)
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Snippet:
    """A fenced block."""

    path: Path
    line: int
    code: str

    def run(self, names: dict[str, Any]) -> None:
        """Execute Python in the namespace `names`; tracebacks show the line of the Markdown file."""
        exec(compile("\n" * self.line + self.code, str(self.path), "exec", dont_inherit=True), names)

    def smaller(self, numbers: Mapping[str, int]) -> Snippet:
        """The same code with other numbers in its line ``NAME, OTHER = 64, 200``, for those that are named."""
        if not numbers:
            return self
        return replace(self, code=CONSTANTS.sub(lambda match: smaller_line(match, numbers), self.code))


def smaller_line(line: re.Match[str], numbers: Mapping[str, int]) -> str:
    """A line of constants with other numbers."""
    names, values = line[1].split(", "), line[2].split(", ")
    pairs = zip(names, values, strict=True)
    return f"{line[1]} = {', '.join(str(numbers.get(name, value)) for name, value in pairs)}"


def snippets(path: str, language: str = "python") -> list[Snippet]:
    """All blocks of a language in a file of the repository, in order."""
    source = ROOT / path
    text = source.read_text()
    return [
        Snippet(source, text[: match.start()].count("\n") + 1, match[2])
        for match in FENCE.finditer(text)
        if match[1] == language
    ]


def sections(path: str) -> dict[str, list[Snippet]]:
    """The blocks of Python below each heading of the second level, by its words."""
    text = (ROOT / path).read_text()
    headings = [(text[: match.start()].count("\n") + 1, match[1]) for match in HEADING.finditer(text)]
    found: dict[str, list[Snippet]] = {words: [] for _, words in headings}
    for block in snippets(path):
        above = [words for line, words in headings if line < block.line]
        if above:
            found[above[-1]].append(block)
    return found


STEP = re.compile(r"`([\w/.]+\.py)`(?:, below `([^`]+)`)?:\n\n```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Walk:
    """A step: a new file, or lines `below` the line of a file that begins so."""

    path: str
    below: str | None
    code: str

    def makes(self, name: str) -> bool:
        """Whether the full name of a module or an object is one that this step brings."""
        package, _, last = name.rpartition(".")
        return Path(self.path).parts[-2] == package.rpartition(".")[2] and last in self.code

    def follow(self, root: Path) -> None:
        """Do in the tree at `root` what the step says."""
        file = root / self.path
        if self.below is None:
            assert not file.exists(), f"{self.path} is there already"
            file.write_text(self.code, encoding="utf-8")
            return
        text = file.read_text(encoding="utf-8")
        before, line, after = re.split(rf"^({re.escape(self.below)}.*\n)", text, maxsplit=1, flags=re.MULTILINE)
        file.write_text(before + line + self.code + after, encoding="utf-8")


def walks() -> list[Walk]:
    """All steps, in the order of the page."""
    return [
        Walk(path, below or None, code) for path, below, code in STEP.findall((ROOT / "CONTRIBUTING.md").read_text())
    ]
