"""The HTML of a comparison: pictures as data, the table, histograms, what was rendered."""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from djpt.errors import BackendError
from djpt.validation import report
from djpt.validation.metrics import MEASURES, colours
from djpt.validation.references import machine, versions
from djpt.validation.report import document, read_beside

if TYPE_CHECKING:
    from djpt.validation.comparison import Comparison

__all__ = ["bytes_of", "halves_of", "histogram", "html", "packed", "write_page"]

BINS = 72
Z_SHOWN = 6.0
"""The deviates at the ends of the map of z, and of its histogram."""


def write_page(result: Comparison, path: str | os.PathLike[str]) -> None:
    """Write `html(result)`. Raises `FileError` for names without ``.html`` and for paths that can't be written."""
    target = report.check_page(path, "the report of a comparison")
    report.write_page(target, html(result))


def html(result: Comparison) -> str:
    """The page as text. It holds both images as 16-bit floats, their difference with digits of its own, and z."""
    flip = flip_of(result)  # first: the table shows its mean
    name = escape(result.name)
    parts = [
        f"<header><h1>{name}</h1><p class={'good' if result.passed else 'bad'}>{escape(result.verdict)}</p></header>",
        failures(result),
        read_beside(__file__, "panels.html"),
        table(result),
        histograms(result),
        origin(result),
    ]
    end = (
        f'<script type="application/json" id="data">{data(result, flip)}</script>\n'
        f"<script>\n{read_beside(__file__, 'page.js')}</script>"
    )
    title = f"{name}: {escape(result.titles[0])} and {escape(result.titles[1])}"
    return document(title, read_beside(__file__, "page.css"), parts, end)


def flip_of(result: Comparison) -> np.ndarray[Any, Any] | None:
    """FLIP per pixel, or None where its package isn't installed."""
    try:
        return result.flip_map
    except BackendError:
        return None


def data(result: Comparison, flip: np.ndarray[Any, Any] | None) -> str:
    """The pictures as JSON: the image and the difference; the reference is what they leave."""
    image = colours(np.asarray(result.image, np.float64))
    difference = image - colours(np.asarray(result.reference, np.float64))
    height, width, _ = image.shape
    size = np.abs(difference.mean(axis=2))
    found: dict[str, Any] = {
        "width": width,
        "height": height,
        "titles": list(result.titles),
        "image": halves_of(image),
        "difference": halves_of(difference),
        "range": max(float(np.quantile(size, 0.99)), float(size.max()) * 1e-3, 1e-12),
        "z": None if result.z_map is None else bytes_of(result.z_map, -Z_SHOWN, Z_SHOWN),
        "flip": None if flip is None else bytes_of(flip, 0.0, 1.0),
    }
    # In a script "</script" would end it, and "<!--<script" would let it run to the end of the page.
    return json.dumps(found).replace("<", "\\u003c")


# ---- numbers -------------------------------------------------------------------------------------


def failures(result: Comparison) -> str:
    """The failures, as a list."""
    if result.passed:
        return ""
    return '<ul class="bad">' + "".join(f"<li>{escape(line)}</li>" for line in result.failures) + "</ul>"


def table(result: Comparison) -> str:
    """The table of all measures and tests."""
    cheap = [name for name in MEASURES if name not in ("flip", "hdr_flip")]
    shown = (*cheap, *(name for name in ("flip", "hdr_flip") if has(result, name)))
    rows = "".join(
        f"<tr><th scope=row>{escape(what.strip())}</th><td>{escape(value)}</td><td>{escape(limit)}</td>"
        f"<td class={'bad' if verdict == 'FAILED' else 'good'}>{escape(verdict)}</td></tr>"
        for what, value, limit, verdict in result.rows(shown)
    )
    head = "<tr><th>measure</th><th>value</th><th>limit</th><th></th></tr>"
    return f'<section id="numbers"><h2>Numbers</h2><table><thead>{head}</thead><tbody>{rows}</tbody></table></section>'


def has(result: Comparison, name: str) -> bool:
    """True if a measure can be computed: FLIP needs its package, and HDR-FLIP a reference that isn't black."""
    try:
        return math.isfinite(result.measure(name))
    except (BackendError, AssertionError):
        return False


def histograms(result: Comparison) -> str:
    """Histograms of the values of both images, of their difference, and of z."""
    image, reference = (np.asarray(side, np.float64) for side in (result.image, result.reference))
    low, high = decades(np.concatenate([image.ravel(), reference.ravel()]))
    edges = np.linspace(low, high, BINS + 1)
    counts = [
        (title, np.histogram(np.log10(np.clip(side, 10.0**low, 10.0**high)), edges)[0].astype(np.float64))
        for title, side in zip(result.titles, (image, reference), strict=True)
    ]
    drawn = [histogram("Values, by decades", edges, counts, [(k, f"1e{k}") for k in range(low, high + 1)])]

    difference = image - reference
    most = float(np.max(np.abs(difference))) or 1.0
    edges = np.linspace(-most, most, BINS + 1)
    counts = [("difference", np.histogram(difference, edges)[0].astype(np.float64))]
    ticks = [(-most, f"−{most:.2g}"), (0.0, "0"), (most, f"{most:.2g}")]
    drawn.append(histogram("Difference, logarithmic counts", edges, counts, inward(ticks), logarithmic=True))

    if result.z_map is not None and result.tests:
        edges = np.linspace(-Z_SHOWN, Z_SHOWN, BINS + 1)
        z = np.clip(result.z_map, -Z_SHOWN, Z_SHOWN)
        counts = [("z of each pixel's worst channel", np.histogram(z, edges)[0].astype(np.float64))]
        if result.image.shape[2] == 1:
            counts.append(("noise alone", normal_counts(edges, z.size)))
        drawn.append(histogram("Deviates", edges, counts, [(k, f"{k:+d}" if k else "0") for k in range(-4, 5, 2)]))
    return f'<section id="histograms"><h2>Histograms</h2><div class="row">{"".join(drawn)}</div></section>'


def inward(ticks: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """The ticks of an axis, the outer ones moved inwards to 9 tenths so that their labels fit."""
    return [(0.9 * place, text if place == 0 else f"{0.9 * place:.2g}".replace("-", "−")) for place, text in ticks]


def decades(values: np.ndarray[Any, Any]) -> tuple[int, int]:
    """The powers of ten between which values are shown: at most six decades, down from the largest value."""
    positive = values[values > 0]
    if not positive.size:
        return -1, 0
    high = math.ceil(math.log10(float(positive.max())) + 1e-9)
    low = math.floor(math.log10(float(np.quantile(positive, 0.001))))
    return max(min(low, high - 1), high - 6), high


# ---- origin --------------------------------------------------------------------------------------


def origin(result: Comparison) -> str:
    """The origin of the images: scenes, programs and machines."""
    blocks = []
    for title, facts in zip(result.titles, result.facts, strict=True):
        lines = "".join(fact(name, value) for name, value in facts.items())
        blocks.append(f"<div><h3>{escape(title)}</h3><dl>{lines}</dl></div>")
    here = "".join(fact(name, value) for name, value in {**versions(), **machine()}.items())
    blocks.append(f"<div><h3>Compared by</h3><dl>{here}</dl></div>")
    return f'<section id="origin"><h2>What was rendered</h2><div class="row">{"".join(blocks)}</div></section>'


def fact(name: str, value: Any) -> str:
    """One fact: dicts that hold others are folded."""
    if isinstance(value, Mapping):
        text = escape(json.dumps(value, indent=1, ensure_ascii=False))
        return f"<dt>{escape(name)}</dt><dd><details><summary>show</summary><pre>{text}</pre></details></dd>"
    shown = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
    return f"<dt>{escape(name)}</dt><dd>{escape(shown)}</dd>"


# ---- histograms as SVG -----------------------------------------------------------------------


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


# ---- arrays inside a page: compressed, as text -----------------------------------------------


Packed = dict[str, Any]

LARGEST_HALF = 65504.0


def packed(array: npt.NDArray[Any]) -> str:
    """The bytes of an array of bytes or of 16-bit numbers, deflated, in base64.

    Of 16-bit numbers all lower bytes come before all higher ones: the higher bytes of neighbours are alike, which
    makes the text a fifth shorter.
    """
    flat = np.ascontiguousarray(array).reshape(-1)
    planes = flat.view(np.uint8).reshape(flat.size, flat.itemsize).T
    compressor = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)  # without a header, as browsers inflate it
    data = compressor.compress(np.ascontiguousarray(planes).tobytes()) + compressor.flush()
    return base64.b64encode(data).decode("ascii")


def halves_of(values: npt.NDArray[Any]) -> Packed:
    """Numbers as float16, scaled by a power of two such that the largest of them fits and small ones keep digits."""
    wide = np.asarray(values, np.float64)
    largest = float(np.max(np.abs(wide), initial=0.0))
    scale = 2.0 ** np.floor(np.log2(LARGEST_HALF / largest)) if largest > 0 else 1.0
    return {"scale": float(1 / scale), "data": packed((wide * scale).astype("<f2"))}


def bytes_of(values: npt.NDArray[Any], low: float, high: float) -> Packed:
    """Numbers in 255 equal steps from `low` to `high`; those outside are clipped."""
    steps = np.rint((np.clip(values, low, high) - low) / (high - low) * 254)
    return {"low": low, "high": high, "data": packed(steps.astype(np.uint8))}
