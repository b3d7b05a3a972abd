"""Measure the gradient matrix and write its page: ``python benchmarks/gradient_matrix.py`` (20 minutes, two cores)."""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from tests.gradients.matrix import CELLS, Cell, Outcome  # noqa: E402

HEAD = """# The gradient matrix

Derivatives of small images with respect to each kind of parameter, compared with central differences. In each scene a
number moves something or changes a parameter; the derivative is that of a weighted sum of all pixels, by forward mode.
It is *right* if it is within 3 % or 4 standard errors of central differences (two steps, Richardson's extrapolation,
images by `path` or `volpath`, 2048 or 8192 samples per pixel, 4 to 32 seeds); *noisy* if it is, but the standard error
is more than 3 % of the derivative and 0.1 % of the sum; *refused* if an error says what would be wrong and what to do.

`python benchmarks/gradient_matrix.py` made this page with djpt {version}; `make check` measures it again.

{count} of {total} cells were measured: {counts}.
"""


def page(found: dict[str, Outcome]) -> str:
    """The page, from the outcomes by the labels of cells."""
    counts = Counter(outcome.verdict for outcome in found.values())
    told = ", ".join(f"{number} {verdict}" for verdict, number in counts.most_common())
    lines = [HEAD.format(version=djpt.__version__, count=len(found), total=len(CELLS), counts=told)]
    for group in dict.fromkeys(cell.group for cell in CELLS.values()):
        lines.append(f"\n## {group[0].upper()}{group[1:]}\n")
        lines.append(
            "| | integrator | derivative | differences | standard error | z | |\n|---|---|---|---|---|---|---|"
        )
        lines += [row(cell, found[label]) for label, cell in CELLS.items() if cell.group == group and label in found]
    reasons = dict.fromkeys(outcome.reason for outcome in found.values() if outcome.verdict == "refused")
    return "\n".join([*lines, "\n## Why derivatives are refused\n", *(f"* {text}" for text in sorted(reasons)), ""])


def row(cell: Cell, outcome: Outcome) -> str:
    """A line of a table."""
    start = f"| {cell.name} | `{cell.integrator['type']}` |"
    if outcome.verdict == "refused":
        return f"{start} | | | | refused |"
    numbers = f"{outcome.found:.4g} | {outcome.expected:.4g} | {outcome.error:.2g} | {outcome.z:+.1f}"
    return f"{start} {numbers} | {outcome.verdict} |"


def main() -> None:
    """Measure all cells."""
    found = {}
    for number, (label, cell) in enumerate(CELLS.items(), 1):
        found[label] = cell.measured()
        print(f"{number}/{len(CELLS)} {label}: {found[label].verdict}", flush=True)
    (ROOT / "docs" / "gradient-matrix.md").write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
