"""Curves of errors, drawn as SVG on doubly logarithmic axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["Curve", "chart", "plain"]

WIDTH, HEIGHT = 460, 380
LEFT, RIGHT, TOP, BOTTOM = 44, 344, 12, 340
"""The box of the axes, in units of the picture."""

LINE = 13
"""The height of a label, in units of the picture."""

GAP = 0.06
"""Space around the data, as a share of the box."""


@dataclass(frozen=True)
class Curve:
    """A curve through points (x, y); those that aren't positive are left out."""

    title: str
    number: int
    """The number of the curve's colour."""
    points: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]
    """A note for each point, shown when the pointer is over it."""
    floor: float = 0.0
    """The y that the curve approaches; 0: none."""


class Axis:
    """A logarithmic axis, which maps numbers to places in the picture."""

    def __init__(self, values: Sequence[float], begin: float, end: float) -> None:
        low, high = math.log10(min(values)), math.log10(max(values))
        if high - low < 1:
            low, high = (low + high - 1) / 2, (low + high + 1) / 2
        margin = GAP * (high - low)
        self.low, self.high, self.begin, self.end = low - margin, high + margin, begin, end

    def place(self, value: float) -> float:
        """The place of `value`."""
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return self.begin + share * (self.end - self.begin)

    def ticks(self) -> list[float]:
        """The numbers to be marked: powers of ten, and 2 and 5 times these if the axis is short."""
        steps = (1, 2, 5) if self.high - self.low < 2.2 else (1,)
        decades = range(math.floor(self.low), math.ceil(self.high) + 1)
        found = [step * 10.0**decade for decade in decades for step in steps]
        return [value for value in found if self.low <= math.log10(value) <= self.high]


def chart(title: str, x_title: str, y_title: str, curves: Sequence[Curve], level: float = 0.0) -> str:
    """An SVG element: curves with their names at the right, and dotted lines of slope -1/2.

    Args:
        title: Description for people who can't see the picture.
        x_title: Title of the horizontal axis, with its unit.
        y_title: Title of the vertical axis, with its unit.
        curves: The curves, drawn in this order.
        level: Height of a dashed horizontal line, the noise of the reference; 0: none.
    """
    drawn = [curve for curve in curves if positive(curve)]
    if not drawn:
        return f'<p class="note">{escape(title)}: no error above the noise of the reference.</p>'
    xs, ys = zip(*(point for curve in drawn for point in positive(curve)), strict=True)
    x, y = Axis(xs, LEFT, RIGHT), Axis(ys, BOTTOM, TOP)
    parts = [*grid(x, y), *slopes(x, y), *axis_titles(x_title, y_title)]
    if level > 0 and y.low < math.log10(level) < y.high:
        at = y.place(level)
        parts.append(f'<path class="level" d="M{LEFT} {at:.1f}H{RIGHT}"/>')
        parts.append(f'<text class="small" x="{LEFT + 4}" y="{at - 4:.1f}">noise of the reference</text>')
    for curve, label in zip(drawn, spread([y.place(positive(c)[-1][1]) for c in drawn]), strict=True):
        parts.append(line(curve, x, y, label))
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">'
        f"{''.join(parts)}</svg>"
    )


def positive(curve: Curve) -> list[tuple[float, float]]:
    """The points of a curve that logarithmic axes can show."""
    return [(x, y) for x, y in curve.points if x > 0 and y > 0]


def grid(x: Axis, y: Axis) -> list[str]:
    """Draw the lines and numbers of both axes."""
    parts = []
    for value in x.ticks():
        at = x.place(value)
        parts.append(f'<path class="grid" d="M{at:.1f} {TOP}V{BOTTOM}"/>')
        parts.append(f'<text x="{at:.1f}" y="{BOTTOM + 15}" text-anchor="middle">{plain(value)}</text>')
    for value in y.ticks():
        at = y.place(value)
        parts.append(f'<path class="grid" d="M{LEFT} {at:.1f}H{RIGHT}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{plain(value)}</text>')
    return parts


def slopes(x: Axis, y: Axis) -> list[str]:
    """Draw dotted lines y = c x^(-1/2), a decade apart, clipped to the box."""
    parts = []
    first, last = math.floor(y.low + x.low / 2), math.ceil(y.high + x.high / 2)
    for log_c in range(first, last + 1):
        # Where the line enters and leaves, in decades of x.
        enters, leaves = max(x.low, 2 * (log_c - y.high)), min(x.high, 2 * (log_c - y.low))
        if enters < leaves:
            ends = [(10.0**u, 10.0 ** (log_c - u / 2)) for u in (enters, leaves)]
            (x0, y0), (x1, y1) = ((x.place(u), y.place(v)) for u, v in ends)
            parts.append(f'<path class="slope" d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}"/>')
    return parts


def axis_titles(x_title: str, y_title: str) -> list[str]:
    """Draw the titles of the axes."""
    middle = (TOP + BOTTOM) / 2
    return [
        f'<text x="{(LEFT + RIGHT) / 2}" y="{HEIGHT - 6}" text-anchor="middle">{escape(x_title)}</text>',
        f'<text x="10" y="{middle}" text-anchor="middle" transform="rotate(-90 10 {middle})">{escape(y_title)}</text>',
    ]


def line(curve: Curve, x: Axis, y: Axis, label: float) -> str:
    """Draw a curve, its points, its floor and its name at the height `label`."""
    kept = positive(curve)
    notes = [note for (px, py), note in zip(curve.points, curve.notes, strict=True) if px > 0 and py > 0]
    places = [(x.place(px), y.place(py)) for px, py in kept]
    end_x, end_y = places[-1]
    path = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in places)
    parts = [f'<path class="leader" d="M{end_x:.1f} {end_y:.1f}L{RIGHT + 4} {label:.1f}"/>', f'<path d="{path}"/>']
    if curve.floor > 0 and y.low < math.log10(curve.floor) < y.high:
        parts.append(f'<path class="floor" d="M{end_x:.1f} {y.place(curve.floor):.1f}H{RIGHT}"/>')
    for (px, py), note in zip(places, notes, strict=True):
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="2.2"><title>{escape(note)}</title></circle>')
    parts.append(f'<text x="{RIGHT + 7}" y="{label + 4:.1f}">{escape(curve.title)}</text>')
    return f'<g class="curve color{curve.number}" data-title="{escape(curve.title)}">{"".join(parts)}</g>'


def spread(heights: Sequence[float]) -> list[float]:
    """Move the heights of labels apart so that they don't overlap, by as little as possible."""
    order = sorted(range(len(heights)), key=lambda i: heights[i])
    # Labels that would overlap form a group around the mean of their heights.
    groups: list[list[int]] = []

    def middle(group: list[int]) -> float:
        wanted = sum(heights[i] for i in group) / len(group)
        half = (len(group) - 1) * LINE / 2
        return min(max(wanted, TOP + half), BOTTOM - half)

    for i in order:
        groups.append([i])
        while len(groups) > 1:
            above, below = groups[-2:]
            reach = (len(above) + len(below)) * LINE / 2
            if middle(below) - middle(above) >= reach:
                break
            groups[-2:] = [above + below]
    places = [0.0] * len(heights)
    for group in groups:
        for k, i in enumerate(group):
            places[i] = middle(group) + (k - (len(group) - 1) / 2) * LINE
    return places


def plain(value: float) -> str:
    """Format a number as people write it: 0.02, 5, 1 k, 20 M; as a power of ten where that is too long."""
    if not value > 0:
        return "0"
    if 0.99e-3 < value < 1e3:
        return f"{value:.3g}"
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= factor * 0.999:
            return f"{value / factor:.3g} {prefix}"
    digits = str(math.floor(math.log10(value) + 1e-9)).replace("-", "⁻")
    exponent = digits.translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))
    first = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
    return f"10{exponent}" if first == 1 else f"{first}·10{exponent}"
