"""Cases: small programs with the files that they read."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["HEADER", "Case"]

HEADER = """from math import inf, nan
import numpy as np
import djpt
import drjit as dr
T = djpt.ScalarTransform4f
"""
"""What every program begins with."""


@dataclass
class Case:
    """A program that djpt must survive."""

    code: str
    """Its text, without `HEADER`. The image that it computes, if any, is its variable `image`."""
    files: dict[str, bytes] = field(default_factory=dict)
    """The files in its folder, by name."""
    names: tuple[str, ...] = ()
    """Words of which an error must contain one: the node, the file or the argument that is wrong."""
    finite: bool = False
    """Whether all its numbers are ordinary, so that its image must be finite."""

    alone: bool = False
    """Whether it may open no file of data outside of its folder."""

    def __repr__(self) -> str:
        return self.code

    def save(self, folder: Path) -> None:
        """Write the program as `case.py`, with its files, to a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        (folder / "case.py").write_text(HEADER + self.code + "\n", encoding="utf-8", errors="backslashreplace")
