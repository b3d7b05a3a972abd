"""The HTML of a comparison: pictures as data, the table, histograms, what was rendered."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from djpt.core.files import as_path, check_target, writing
from djpt.errors import BackendError, FileError
from djpt.validation.measures import MEASURES
from djpt.validation.page.histograms import histogram, normal_counts
from djpt.validation.page.packing import bytes_of, halves_of
from djpt.validation.perceptual import colours
from djpt.validation.provenance import machine, versions

if TYPE_CHECKING:
    from djpt.validation.comparison import Comparison

__all__ = ["html", "write_page"]

BINS = 72
Z_SHOWN = 6.0
"""The deviates at the ends of the map of z, and of its histogram."""


def write_page(result: Comparison, path: str | os.PathLike[str]) -> None:
    """Write `html(result)`. Raises `FileError` for names without ``.html`` and for paths that can't be written."""
    target = as_path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"can't write '{target}': the report of a comparison is a page, .html")
    check_target(target)
    text = html(result)
    with writing(target) as temporary:
        # Names of files may hold bytes that aren't UTF-8.
        temporary.write_text(text, encoding="utf-8", errors="replace")


def html(result: Comparison) -> str:
    """The page as text. It holds both images as 16-bit floats, their difference with digits of its own, and z."""
    flip = flip_of(result)  # first: the table shows its mean
    name = escape(result.name)
    parts = [
        f"<header><h1>{name}</h1><p class={'good' if result.passed else 'bad'}>{escape(result.verdict)}</p></header>",
        failures(result),
        (Path(__file__).parent / "panels.html").read_text(encoding="utf-8"),
        table(result),
        histograms(result),
        origin(result),
    ]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<link rel="icon" href="data:,">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}: {escape(result.titles[0])} and {escape(result.titles[1])}</title>\n"
        f"<style>\n{beside('page.css')}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + f'\n</main>\n<script type="application/json" id="data">{data(result, flip)}</script>\n'
        f"<script>\n{beside('page.js')}</script>\n</body>\n</html>\n"
    )


def beside(name: str) -> str:
    """Read a file in this folder."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


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
