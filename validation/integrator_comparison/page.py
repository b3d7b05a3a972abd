"""The results of `measure` as one HTML file that needs no other: pictures, curves, numbers."""

from __future__ import annotations

import math
import os
from html import escape
from pathlib import Path

import djpt
from djpt.jit.backends import variant
from djpt.validation.integrator_comparison.curves import Curve, chart, plain
from djpt.validation.integrator_comparison.measure import Ladder, Measured
from djpt.validation.integrator_comparison.pictures import (
    ERROR_COLORS,
    address,
    error_map,
    error_range,
    pixel_errors,
    shown,
)

__all__ = ["html"]

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
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: a ladder of algorithms</title>\n"
        f"<style>\n{beside('page.css')}{''.join(hues)}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in sections if part)
        + f"\n</main>\n{DIALOG}\n<script>\n{beside('compare.js')}</script>\n</body>\n</html>\n"
    )


def beside(name: str) -> str:
    """Read a file in this folder."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


DIALOG = """<dialog id="compare" aria-label="Comparison of two pictures">
<header><strong></strong><button value="previous" aria-label="Previous">←</button>
<button value="next" aria-label="Next">→</button>
<form method="dialog"><button>Close</button></form></header>
<div class="stack"></div>
<input type="range" min="0" max="100" value="50" step="0.5" aria-label="Where one picture ends and the other begins">
<div class="choice"><span class="note">On the right:</span><button value="reference">reference</button>
<button value="errors">error</button></div>
</dialog>"""


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
        f'<img id="reference" src="{address(shown(reference.image))}" alt="{name}, the reference">'
        f'<figcaption><strong>reference</strong><span class="numbers">{plain(reference.spp)} spp</span>'
        f"<span>{escape(reference.title)}, other seeds.</span>{leaves_out(reference.missing)}"
        f"{remarks(reference.notes)}</figcaption></figure>"
    ]
    for i, found in enumerate(ladder.measured):
        title = escape(found.step.title)
        alt = f"{name} by {title}, {found.last.spp} samples per pixel"
        picture = f'<img src="{address(shown(found.image))}" alt="{alt}" data-step="{i}" data-title="{title}">'
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
        picture = f'<img id="errors-{i}" src="{address(error_map(error, low, high))}" alt="{alt}">'
        numbers = f'<span class="numbers">RMSE {decimals(found.last.rmse)}</span>'
        cards.append(f"<figure>{picture}<figcaption><strong>{title}</strong>{numbers}</figcaption></figure>")
    ticks = "".join(f"<span>{plain(10.0**k)}</span>" for k in range(low, high + 1))
    bar = f'<img src="{address(ERROR_COLORS[None])}" alt="Colours of errors from 1e{low} to 1e{high}">'
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
