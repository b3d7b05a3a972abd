"""A bar while something is rendered: in a notebook, or in a terminal."""

from __future__ import annotations

import contextlib
import html
import time
from collections.abc import Callable, Iterator

from djpt.display.notebooks import running_notebook
from djpt.errors import RenderError

__all__ = ["Progress", "watched"]

Progress = Callable[[int, int], None]
"""A function called with the work done and the work in all, in units of the caller."""

INTERVAL = 0.1
"""The least time between two pictures of the bar, in seconds."""


@contextlib.contextmanager
def watched(progress: Progress | bool | None, title: str, unit: str) -> Iterator[Progress | None]:
    """Give the function to be called while something is done: `progress`, or if it is True one that shows a bar.

    The bar is gone in the end. Where there is neither a notebook nor a terminal, nothing is shown.

    Raises:
        RenderError: `progress` is neither a function nor True, False or None.
    """
    if progress is None or progress is False:
        yield None
    elif callable(progress):
        yield progress
    elif progress is not True:
        raise RenderError(f"'progress' must be a function or True, found {type(progress).__name__}")
    elif running_notebook():
        with notebook_bar(title, unit) as show:
            yield show
    else:
        from djpt.cli.console import progress_bar

        with progress_bar(title, unit, quiet=False) as show:
            yield show


@contextlib.contextmanager
def notebook_bar(title: str, unit: str) -> Iterator[Progress]:
    """A bar below the cell that runs."""
    from IPython.display import HTML, display

    handle = display(HTML(markup(title, unit, 0, 1, 0.0)), display_id=True)
    start = shown = time.perf_counter()

    def show(done: int, total: int) -> None:
        nonlocal shown
        now = time.perf_counter()
        if now - shown >= INTERVAL:
            shown = now
            handle.update(HTML(markup(title, unit, done, total, now - start)))

    try:
        yield show
    finally:
        handle.update(HTML(""))


def markup(title: str, unit: str, done: int, total: int, seconds: float) -> str:
    """The bar as HTML, with the speed and the time left once they can be known."""
    from djpt.cli.console import short

    text = f"{done / total:.0%}"
    if done and seconds > 0:
        text += f", {short(done / seconds)}{unit}/s, {seconds * (total - done) / done:.0f} s left"
    return f'{html.escape(title)} <progress value="{done}" max="{total}"></progress> {text}'
