"""The live display of a search: its loss, its parameters, and its images beside their targets."""

from __future__ import annotations

import html
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from djpt.apps.display import displayed, source
from djpt.rendering.progress import running_notebook

__all__ = ["LiveSearch", "Progressed", "curve", "markup", "sparkline"]

INTERVAL = 0.5
"""The minimum time between two displays, in seconds."""

BARS = "▁▂▃▄▅▆▇█"
WIDTH, HEIGHT = 320, 80
"""The size of the loss curve, in pixels."""

FEW = 8
"""Parameters of at most this many numbers are shown as text."""


@dataclass(frozen=True)
class Progressed:
    """The state that a callback gets after each iteration."""

    iteration: int
    loss: float
    """The loss over the views of this iteration, priors included."""
    values: Mapping[str, Any]
    """The parameters."""
    seconds: float
    """The time since the start."""
    images: Mapping[int, Any] = field(default_factory=dict)
    """The images of this iteration, (H, W, C) each, by their sensors."""
    targets: Mapping[int, npt.NDArray[np.float32]] = field(default_factory=dict)
    """The pictures that they should match."""


class LiveSearch:
    """A callback that shows a search after each iteration: a picture below the cell of a notebook, or a terminal line.

    Elsewhere nothing is shown. Used in a ``with`` statement, which shows the last iteration at its end.

    Args:
        losses: those of earlier iterations.
    """

    def __init__(self, losses: Sequence[float] = ()) -> None:
        self._losses, self._shown = list(losses), 0.0
        self._handle: Any = None
        self._done: Progressed | None = None

    def __call__(self, done: Progressed) -> None:
        """Record an iteration, and show it if the last one was shown long enough."""
        self._losses.append(done.loss)
        self._done = done
        if time.perf_counter() - self._shown < INTERVAL:
            return
        if running_notebook():
            self._handle = displayed(markup(done, self._losses), self._handle)
        elif sys.stderr is not None and sys.stderr.isatty():
            print(self._line(done), end="", file=sys.stderr, flush=True)
        self._shown = time.perf_counter()

    def __enter__(self) -> LiveSearch:
        return self

    def __exit__(self, *error: object) -> None:
        if self._done is not None and running_notebook():
            displayed(markup(self._done, self._losses), self._handle)
        elif self._done is not None and sys.stderr is not None and sys.stderr.isatty():
            print(self._line(self._done), file=sys.stderr)

    def _line(self, done: Progressed) -> str:
        return f"\r{done.iteration + 1} {sparkline(self._losses)} loss {done.loss:.3g}\033[K"


def markup(done: Progressed, losses: Sequence[float]) -> str:
    """A search as self-contained HTML: the curve, the parameters, a row of pictures for each view."""
    rows = []
    for key, value in done.values.items():
        numbers = np.array(value, np.float64).ravel()
        said = ", ".join(f"{x:.4g}" for x in numbers)
        if numbers.size > FEW:
            said = f"{numbers.size} numbers from {numbers.min():.3g} to {numbers.max():.3g}"
        rows.append(f"<tr><td>{html.escape(key)}</td><td>{said}</td></tr>")
    for key, value in done.values.items():
        texels = np.array(value, np.float32)
        if texels.ndim == 3 and texels.shape[2] in (1, 3) and texels.size > FEW:
            rows.append(f"<tr><td>{html.escape(key)}</td><td>{picture(texels)}</td></tr>")
    views = [f"{picture(image)}{picture(done.targets[view])}" for view, image in done.images.items()]
    caption = f"iteration {done.iteration + 1}, loss {done.loss:.4g}; images and their targets"
    pictures = "<br>".join(views)
    return f"<figure>{curve(losses)}<table>{''.join(rows)}</table>{pictures}<figcaption>{caption}</figcaption></figure>"


def picture(pixels: Any) -> str:
    """Linear pixels (H, W, C) as an image within HTML."""
    address = source(np.array(pixels, np.float32))
    return f'<img src="{address}" style="image-rendering:pixelated;min-width:96px;margin:2px">'


def heights(losses: Sequence[float]) -> list[float]:
    """The logarithms of losses between 0, the least of all, and 1, the greatest."""
    positive = [loss for loss in losses if loss > 0 and math.isfinite(loss)]
    if not positive:
        return [0.0] * len(losses)
    low, high = math.log(min(positive)), math.log(max(positive))
    clipped = [min(max(loss, min(positive)), max(positive)) if loss == loss else max(positive) for loss in losses]
    return [(math.log(loss) - low) / max(high - low, 1e-6) for loss in clipped]


def curve(losses: Sequence[float]) -> str:
    """The losses over the iterations as an SVG, on a logarithmic scale."""
    last = max(len(losses) - 1, 1)
    points = [
        f"{4 + (WIDTH - 8) * i / last:.1f},{4 + (HEIGHT - 8) * (1 - y):.1f}" for i, y in enumerate(heights(losses))
    ]
    line = f'<polyline points="{" ".join(points)}" fill="none" stroke="currentColor"/>'
    return f'<svg width="{WIDTH}" height="{HEIGHT}">{line}</svg><br>'


def sparkline(losses: Sequence[float], width: int = 24) -> str:
    """The latest losses as bars in a line of text, on a logarithmic scale."""
    return "".join(BARS[round(y * (len(BARS) - 1))] for y in heights(losses[-width:]))
