"""The code in Markdown files, for tests that run it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tests.kit.processes import ROOT

__all__ = ["Snippet", "sections", "snippets"]

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
