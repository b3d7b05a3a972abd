"""The results of `measure` as one HTML file that needs no other: pictures, curves, numbers."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import numpy.typing as npt

import djpt
from djpt.images.formats import encode_png
from djpt.images.image import Image, png_address
from djpt.images.srgb import to_srgb8
from djpt.jit.backends import variant
from djpt.validation.integrator_comparison.measure import Ladder, Measured
from djpt.validation.report import document, read_beside

__all__ = ["ERROR_COLORS", "Curve", "chart", "error_map", "html", "plain", "shown"]

GOLDEN_ANGLE = 137.5
"""The angle between the hues of neighbouring curves, in degrees."""


def html(ladder: Ladder) -> str:
    """Write the page of a ladder, as text."""
    name = escape(ladder.name)
    hues = "".join(
        f".color{i} {{ --hue: {(250 + GOLDEN_ANGLE * i) % 360:.1f}; }}\n" for i in range(len(ladder.measured))
    )
    sections = [
        heading(ladder),
        pictures(ladder),
        charts(ladder),
        table(ladder),
        maps(ladder),
        refused(ladder),
        method(ladder),
    ]
    style = read_beside(__file__, "page.css") + hues
    end = f"{read_beside(__file__, 'dialog.html')}<script>\n{read_beside(__file__, 'compare.js')}</script>"
    return document(f"{name}: a ladder of algorithms", style, sections, end)


def heading(ladder: Ladder) -> str:
    """Write the heading: scene, size and limit of the comparison."""
    width, height = ladder.size
    each = f"{plain(ladder.seconds)} s each" if ladder.seconds else f"{ladder.spp} samples per pixel each"
    return (
        f"<header>\n<h1>{escape(ladder.name)}</h1>\n"
        f'<p class="lede">{len(ladder.measured)} algorithms for one picture of {width} × {height} pixels, {each}.</p>\n'
        "</header>"
    )


# ---- pictures ------------------------------------------------------------------------------------


def pictures(ladder: Ladder) -> str:
    """Write the section of all images, the reference first."""
    reference, name = ladder.reference, escape(ladder.name)
    cards = [
        "<figure>"
        f'<img id="reference" src="{embedded(shown(reference.image))}" alt="{name}, the reference">'
        f'<figcaption><strong>reference</strong><span class="numbers">{plain(reference.spp)} spp</span>'
        f"<span>{escape(reference.title)}, other seeds.</span>{leaves_out(reference.missing)}"
        f"{remarks(reference.notes)}</figcaption></figure>"
    ]
    for i, found in enumerate(ladder.measured):
        title = escape(found.step.title)
        alt = f"{name} by {title}, {found.last.spp} samples per pixel"
        picture = f'<img src="{embedded(shown(found.image))}" alt="{alt}" data-step="{i}" data-title="{title}">'
        numbers = f"{plain(found.last.spp)} spp, RMSE {decimals(found.last.rmse)}"
        cards.append(
            f'<figure><button aria-label="Compare {title} with the reference">{picture}</button>'
            f'<figcaption><strong>{title}</strong><span class="numbers">{numbers}</span>'
            f"<span>{escape(found.step.idea)}</span>{leaves_out(found.missing)}"
            f"{remarks(found.notes)}</figcaption></figure>"
        )
    return (
        '<section id="pictures">\n<h2>Pictures</h2>\n<p class="note">Select one to compare it with the reference.</p>\n'
        '<div class="cards pictures">\n' + "\n".join(cards) + "\n</div>\n</section>"
    )


def leaves_out(missing: str) -> str:
    """Write the note on the light that an image doesn't show."""
    return f'<span class="missing">Leaves out {escape(missing)}.</span>' if missing else ""


def remarks(notes: tuple[str, ...]) -> str:
    """Write the renderer's warnings."""
    return "".join(f'<span class="missing">{escape(note)}.</span>' for note in notes)


def maps(ladder: Ladder) -> str:
    """Write the section of error maps."""
    errors = [pixel_errors(found.image, ladder.reference.image) for found in ladder.measured]
    if not errors:
        return ""
    low, high = error_range(errors)
    cards = []
    for i, (found, error) in enumerate(zip(ladder.measured, errors, strict=True)):
        title = escape(found.step.title)
        alt = f"Errors of {title}: RMSE {decimals(found.last.rmse)}"
        picture = f'<img id="errors-{i}" src="{embedded(error_map(error, low, high))}" alt="{alt}">'
        numbers = f'<span class="numbers">RMSE {decimals(found.last.rmse)}</span>'
        cards.append(f"<figure>{picture}<figcaption><strong>{title}</strong>{numbers}</figcaption></figure>")
    ticks = "".join(f"<span>{plain(10.0**k)}</span>" for k in range(low, high + 1))
    bar = f'<img src="{embedded(ERROR_COLORS[None])}" alt="Colours of errors from 1e{low} to 1e{high}">'
    return (
        '<section id="errors">\n<h2>Errors per pixel</h2>\n'
        '<p class="note">Root mean square over the colour channels, in units of radiance. One scale for all.</p>\n'
        f'<div class="scale">{bar}<div>{ticks}</div></div>\n'
        '<div class="cards">\n' + "\n".join(cards) + "\n</div>\n</section>"
    )


# ---- curves --------------------------------------------------------------------------------------


def charts(ladder: Ladder) -> str:
    """Write the section of curves: the error over time and over samples."""
    if not ladder.measured:
        return ""
    over_time = [curve(found, i, "seconds") for i, found in enumerate(ladder.measured)]
    over_spp = [curve(found, i, "spp") for i, found in enumerate(ladder.measured)]
    level = ladder.reference.noise
    return (
        '<section id="curves">\n<h2>Error over time and over samples</h2>\n<div class="charts">\n'
        f"{chart('RMSE over time', 'time (s)', 'RMSE', over_time, level)}\n"
        f"{chart('RMSE over samples per pixel', 'samples per pixel', 'RMSE', over_spp, level)}\n</div>\n"
        '<p class="note">Both axes are logarithmic. Dotted: slope −1/2, four times the samples for half of the error. '
        "Curves that turn level have reached the error of what they leave out.</p>\n</section>"
    )


def curve(found: Measured, number: int, over: str) -> Curve:
    """The curve of one integrator; `over` is the field of its points that is drawn along x."""
    title = found.step.title
    return Curve(
        title=title,
        number=number,
        points=tuple((float(getattr(point, over)), point.rmse) for point in found.points),
        notes=tuple(f"{title}: {p.spp} spp, {p.seconds:.3g} s, RMSE {decimals(p.rmse)}" for p in found.points),
        floor=found.floor if found.at_floor else 0.0,
    )


# ---- numbers -------------------------------------------------------------------------------------

COLUMNS = (
    ("Algorithm", ""),
    ("Samples", "per pixel"),
    ("Speed", "M samples/s"),
    ("Time", "s"),
    ("Compiling", "s"),
    ("RMSE", ""),
    ("Error floor", "RMSE"),
    ("Bias", "× 10⁻³"),
    ("± std. error", "× 10⁻³"),
    ("Time for path's error", "s"),
)


def table(ladder: Ladder) -> str:
    """Write the table of all numbers."""
    path = next((found.last.rmse for found in ladder.measured if found.step.title == "path"), 0.0)
    head = "".join(f'<th scope="col">{name}<small>{unit or "&nbsp;"}</small></th>' for name, unit in COLUMNS)
    rows = "\n".join(row(found, i, path) for i, found in enumerate(ladder.measured))
    return (
        '<section id="numbers">\n<h2>Numbers</h2>\n<div class="scroll"><table>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table></div>\n"
        '<p class="note">An error floor is what no number of samples removes: the light that is left out. A bias of '
        "more than four standard errors is marked as well. Times don't include compiling; “cached” kernels had been "
        "compiled before.</p>\n</section>"
    )


def row(found: Measured, number: int, path_rmse: float) -> str:
    """Write the row of one integrator."""
    last = found.last
    to_path = found.seconds_to(path_rmse) if path_rmse > 0 else math.nan
    biased = abs(found.bias) > 4 * found.bias_error
    cells = [
        (plain(last.spp), False),
        (f"{found.speed / 1e6:.3g}", False),
        (f"{last.seconds:.2f}", False),
        (f"{found.compile_seconds:.2f}" if found.compile_seconds > 0 else "cached", False),
        (decimals(last.rmse), found.at_floor),
        (decimals(found.floor) if found.at_floor else "–", found.at_floor),
        (f"{1000 * found.bias:+.2f}".replace("-", "−"), biased),
        ("–" if math.isnan(found.bias_error) else f"{1000 * found.bias_error:.2f}", False),
        ("never" if math.isinf(to_path) else "–" if math.isnan(to_path) else plain(to_path), math.isinf(to_path)),
    ]
    shown = "".join(f"<td{' class=marked' if marked else ''}>{text}</td>" for text, marked in cells)
    return f'<tr><td><span class="dot color{number}"></span>{escape(found.step.title)}</td>{shown}</tr>'


def decimals(value: float) -> str:
    """Format an error with three digits; 0 is an error that can't be told from the reference's noise."""
    if not value > 0:
        return "≈ 0"
    places = max(0, 2 - math.floor(math.log10(value)))
    return f"{value:.{places}f}" if places < 7 else plain(value)


# ---- words ---------------------------------------------------------------------------------------


def refused(ladder: Ladder) -> str:
    """Write the list of algorithms that don't suit the scene."""
    if not ladder.refused:
        return ""
    items = "\n".join(f"<dt>{escape(no.step.title)}</dt><dd>{escape(no.reason)}</dd>" for no in ladder.refused)
    return f'<section id="refused">\n<h2>Algorithms that refuse this scene</h2>\n<dl>\n{items}\n</dl>\n</section>'


def method(ladder: Ladder) -> str:
    """Write the notes on how the numbers were measured."""
    goal = ladder.reference
    threads = os.cpu_count() or 1
    return (
        '<section id="method">\n<h2>How it was measured</h2>\n'
        f"<p>The reference is {escape(goal.title)} with {plain(goal.spp)} samples per pixel in 16 independent parts, "
        f"rendered in {goal.seconds:.3g} s. Its noise, RMSE {decimals(goal.noise)}, is known from the spread of the "
        "parts and taken out of all RMSE on this page.</p>\n"
        "<p>Each point of a curve is an image with a seed of its own, and its time is that of one call of "
        "<code>render</code>, without compiling. The error floor comes from the two largest images: what their "
        "errors have in common isn't noise.</p>\n"
        f'<p class="note">djpt {escape(djpt.__version__)}, {escape(variant())}, {threads} logical processors.</p>\n'
        "</section>"
    )


# ---- curves as SVG, on doubly logarithmic axes -----------------------------------------------


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


# ---- images as PNG in `data:` addresses, and maps of errors ----------------------------------


Bytes = npt.NDArray[np.uint8]
Pixels = npt.NDArray[np.float64]

OKLAB_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)
"""The two matrices from Oklab to linear sRGB, with a cube between them: B. Ottosson, "A perceptual color space for
image processing", 2020."""


def error_colors(count: int = 256) -> Bytes:
    """A scale of black, violet, red, orange, pale yellow, (count, 3), with Oklab's lightness rising evenly."""
    t = np.linspace(0.0, 1.0, count)
    lightness, chroma, hue = 0.1 + 0.87 * t, 0.02 + 0.15 * np.sin(np.pi * t), np.radians(-75 + 180 * t)
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)
    linear = (lab @ OKLAB_TO_LMS.T) ** 3 @ LMS_TO_RGB.T
    return to_srgb8(np.asarray(linear[None], np.float32))[0]


ERROR_COLORS = error_colors()
"""The colours of `error_map`, from small to large errors."""


def embedded(pixels: Bytes) -> str:
    """Encode bytes of sRGB as a PNG in a `data:` address."""
    stream = io.BytesIO()
    encode_png(stream, pixels)
    return png_address(stream.getvalue())


def shown(image: Pixels) -> Bytes:
    """Convert linear light to bytes of sRGB, (H, W, 1 or 3)."""
    return Image(image.astype(np.float32)).srgb()


def pixel_errors(image: Any, reference: Any) -> Pixels:
    """The root mean square of image - reference over channels, (H, W)."""
    difference = np.asarray(image, np.float64) - np.asarray(reference, np.float64)
    return np.asarray(np.sqrt(np.mean(np.square(difference), axis=2)))


def error_range(errors: list[Pixels]) -> tuple[int, int]:
    """The powers of ten that enclose the errors of several images, but for a few pixels; four decades at most."""
    largest = max(float(np.quantile(error, 0.99)) for error in errors)
    smallest = min(float(np.quantile(error, 0.10)) for error in errors)
    high = math.ceil(math.log10(largest)) if largest > 0 else 0
    low = math.floor(math.log10(smallest)) if smallest > 0 else high - 4
    return max(min(low, high - 1), high - 4), high


def error_map(errors: Pixels, low: int, high: int) -> Bytes:
    """Draw errors in colours, (H, W, 3): black up to 10^low, pale yellow from 10^high, logarithmic in between."""
    t = (np.log10(np.maximum(errors, 10.0**low)) - low) / (high - low)
    return ERROR_COLORS[np.rint(np.clip(t, 0, 1) * (len(ERROR_COLORS) - 1)).astype(int)]
