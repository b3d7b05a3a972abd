"""The code in Markdown files, for tests that run it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.kit.processes import ROOT

__all__ = ["snippets"]

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


def snippets(path: str, language: str = "python") -> list[Snippet]:
    """All blocks of a language in a file of the repository, in order."""
    source = ROOT / path
    text = source.read_text()
    return [
        Snippet(source, text[: match.start()].count("\n") + 1, match[2])
        for match in FENCE.finditer(text)
        if match[1] == language
    ]
