"""The walks of CONTRIBUTING.md: the files that it has readers write, and the lines that it has them add."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from tests.kit.processes import ROOT

__all__ = ["Walk", "walks"]

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
