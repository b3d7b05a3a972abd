"""Measure the gradient matrix and write its page: ``python benchmarks/gradient_matrix.py`` (an hour on two cores).

With words as arguments, only the cells whose labels contain one of them are measured, and the others of the page kept.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from tests.gradients.cells import Cell, Outcome  # noqa: E402
from tests.gradients.matrix import CELLS  # noqa: E402

HEAD = """# The gradient matrix

Derivatives of small images with respect to each kind of parameter, compared with central differences. In each scene a
number moves something or changes a parameter; the derivative is that of a weighted sum of all pixels, by forward mode.
It is *right* if it is within 3 % of central differences, or Welch's test finds z below 4 (two steps, Richardson's
extrapolation, images by `path` or `volpath`, 2048 to 131072 samples per pixel, 4 to 128 seeds, of differences up to
1024); *noisy* if it is, but the standard error is more than 3 % of the derivative and 0.1 % of the sum; *refused* if an
error says what would be wrong and what to do; *wrong* if it is none of these.

Of cameras before scenes (64 x 64 pixels; `tests/gradients/camera_scenes.py`) more is asked: 1 % or z below 4, with
standard errors below 2 %. Their pixels are weighted by the blurred residual of the image against a picture from where
the camera would be a little later: the derivative is that of the loss that a search for the camera begins with. Pixels
of cameras in fog that turn or zoom have such weights, too.

`python benchmarks/gradient_matrix.py` made this page with djpt {version}, its cells at different times; `make check`
measures them again, with 4 seeds each. It also draws scenes at random (`tests/gradients/random_scenes.py`), and
compares whole images of derivatives with differences, block by block (`tests/gradients/block_maps.py`): sums hide what
cancels.

{count} of {total} cells were measured: {counts}.
"""


PAGE = ROOT / "docs" / "gradient-matrix.md"


def page(rows: dict[str, str], reasons: list[str]) -> str:
    """The page, from the lines of tables by the labels of cells, and the reasons of refusals."""
    rows = {label: rows[label] for label in CELLS if label in rows}
    counts = Counter(verdict_of(line) for line in rows.values())
    told = ", ".join(f"{number} {verdict}" for verdict, number in counts.most_common())
    lines = [HEAD.format(version=djpt.__version__, count=len(rows), total=len(CELLS), counts=told)]
    for group in dict.fromkeys(cell.group for cell in CELLS.values()):
        lines.append(f"\n## {group[0].upper()}{group[1:]}\n")
        lines.append(
            "| | integrator | derivative | differences | standard error | z | |\n|---|---|---|---|---|---|---|"
        )
        lines += [line for label, line in rows.items() if CELLS[label].group == group]
    return "\n".join([*lines, NOISY, f"{REASONS}\n", *(f"* {text}" for text in sorted(set(reasons))), ""])


REASONS = "## Why derivatives are refused"

NOISY = """
## Why derivatives are noisy

* *A lamp that touches other shapes*, as one that stands on a floor does, if a camera steps aside before them or they
  move: where both meet, points slide past the lamp at distances down to none, and the change of the solid angle grows
  like the inverse of the distance. The variance is infinite: more samples don't help. Other shapes that touch
  [count as one](theory/moving-geometry.md#shapes-that-see-themselves-or-touch), and before all scenes
  [rays stay as a camera turns](theory/moving-geometry.md#cameras-that-turn): these derivatives are precise.
* *Rough and brushed metal, mirrors, glass and plastic*: [near outlines and at grazing
  angles](theory/moving-geometry.md#smooth-surfaces) derivatives grow without bound. Where most of a weighted sum
  cancels, as that of the plastic ball does, little of it is left beside the noise.
"""


def known() -> tuple[dict[str, str], list[str]]:
    """What the page has: the lines of tables by the labels of cells, and the reasons of refusals."""
    tables, _, reasons = PAGE.read_text(encoding="utf-8").partition(REASONS)
    labels = {start_of(cell): label for label, cell in CELLS.items()}
    rows, group = {}, ""
    for line in tables.splitlines():
        if line.startswith("## "):
            group = line[3:].lower()
        start = "|".join(line.split("|")[:3])
        label = labels.get(f"{group}{start}")
        if label is not None:
            rows[label] = line
    return rows, re.findall(r"^\* (.*)$", reasons, re.MULTILINE)


def start_of(cell: Cell) -> str:
    """The group of a cell, and the first columns of its line."""
    return f"{cell.group}| {cell.name} | `{cell.integrator['type']}` "


def verdict_of(line: str) -> str:
    """The last column."""
    return line.split("|")[-2].strip()


def row(cell: Cell, outcome: Outcome) -> str:
    """A line of a table."""
    start = f"| {cell.name} | `{cell.integrator['type']}` |"
    if outcome.verdict == "refused":
        return f"{start} | | | | refused |"
    numbers = f"{outcome.found:.4g} | {outcome.expected:.4g} | {outcome.error:.2g} | {outcome.z:+.1f}"
    return f"{start} {numbers} | {outcome.verdict} |"


def main(words: list[str]) -> None:
    """Measure all cells, or those whose labels contain any of some words."""
    rows, reasons = known() if words else ({}, [])
    chosen = [label for label in CELLS if not words or any(word in label for word in words)]
    for number, label in enumerate(chosen, 1):
        outcome = CELLS[label].measured()
        rows[label] = row(CELLS[label], outcome)
        reasons += [outcome.reason] if outcome.verdict == "refused" else []
        print(f"{number}/{len(chosen)} {label}: {outcome.verdict}", flush=True)
        PAGE.write_text(page(rows, reasons), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
