"""Histograms as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
import numpy.typing as npt

__all__ = ["histogram", "normal_counts"]

WIDTH, HEIGHT, MARGIN, FOOT = 360, 180, 12, 24

Array = npt.NDArray[np.float64]


def histogram(
    title: str,
    edges: Array,
    series: Sequence[tuple[str, Array]],
    ticks: Sequence[tuple[float, str]],
    logarithmic: bool = False,
) -> str:
    """Draw counts over bins as steps, each series in the colour of the class ``series0``, ``series1``, ...

    Args:
        title: The caption.
        edges: The edges of the bins, ascending, (n + 1).
        series: Names and counts, (n) each.
        ticks: Places on the horizontal axis and what stands there.
        logarithmic: Whether heights are logarithms of counts.
    """
    heights = [np.log10(1 + counts) if logarithmic else counts for _, counts in series]
    top = max((float(np.max(each, initial=0)) for each in heights), default=0.0) or 1.0
    low, high = float(edges[0]), float(edges[-1])

    def x(place: float) -> float:
        return MARGIN + (WIDTH - 2 * MARGIN) * (place - low) / (high - low)

    def y(height: float) -> float:
        return HEIGHT - FOOT - (HEIGHT - FOOT - MARGIN) * height / top

    lines = []
    for i, ((name, _), counts) in enumerate(zip(series, heights, strict=True)):
        points = [f"M{x(low):.1f} {y(0):.1f}"]
        points += [f"V{y(float(c)):.1f}H{x(float(right)):.1f}" for c, right in zip(counts, edges[1:], strict=True)]
        lines.append(f'<path class="series{i}" d="{"".join(points)}V{y(0):.1f}"><title>{escape(name)}</title></path>')
    marks = [
        f'<line x1="{x(place):.1f}" x2="{x(place):.1f}" y1="{y(0):.1f}" y2="{y(0) + 4:.1f}"/>'
        f'<text x="{x(place):.1f}" y="{HEIGHT - 6}" text-anchor="middle">{escape(text)}</text>'
        for place, text in ticks
    ]
    keys = " ".join(f'<span class="key{i}">{escape(name)}</span>' for i, (name, _) in enumerate(series))
    return (
        f'<figure class="histogram"><svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f'<line x1="{MARGIN}" x2="{WIDTH - MARGIN}" y1="{y(0):.1f}" y2="{y(0):.1f}"/>{"".join(lines)}{"".join(marks)}'
        f"</svg><figcaption>{escape(title)} {keys}</figcaption></figure>"
    )


def normal_counts(edges: Array, total: float) -> Array:
    """The number of `total` standard normal deviates that is expected in each bin."""
    below = np.array([0.5 * math.erfc(-edge / math.sqrt(2)) for edge in edges])
    return np.asarray(total * np.diff(below))
