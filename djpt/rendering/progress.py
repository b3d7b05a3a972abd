"""A bar while something is rendered: in a notebook, or in a terminal."""

from __future__ import annotations

import contextlib
import html
import os
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from djpt.core.terminal import beneath, showing_all, visible
from djpt.errors import RenderError

if TYPE_CHECKING:
    from rich.progress import Task
    from rich.text import Text

__all__ = ["Progress", "has_terminal", "progress_bar", "running_notebook", "running_shell", "short", "watched"]

FORCE_TERMINAL = frozenset({"FORCE_COLOR", "TTY_COMPATIBLE"})
"""Variables by which `rich` takes something else for a terminal."""

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
    text = f"{done / total:.0%}"
    if done and seconds > 0:
        text += f", {short(done / seconds)}{unit}/s, {seconds * (total - done) / done:.0f} s left"
    return f'{html.escape(title)} <progress value="{done}" max="{total}"></progress> {text}'


def has_terminal() -> bool:
    """True if there is a terminal to show progress on."""
    return sys.stderr.isatty() or bool(set(os.environ) & FORCE_TERMINAL)


@contextlib.contextmanager
def progress_bar(title: str, unit: str, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Show a bar with `unit`/s and the time left; gives a function to be called with (done, total).

    Nothing is shown with --quiet, or if the output isn't a terminal.
    """
    nothing: Callable[[int, int], None] = lambda done, total: None  # noqa: E731
    # Asked before `rich` is imported, which takes longer than small pictures.
    if quiet or not has_terminal():
        yield nothing
        return

    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    console = Console(file=beneath(sys.stderr))
    if not console.is_terminal:
        yield nothing
        return

    class Speed(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{short(task.speed)}{unit}/s")

    name = TextColumn("{task.description}", markup=False)
    columns: list[Any] = [name, BarColumn(), TaskProgressColumn(), Speed(), TimeRemainingColumn()]
    # `rich` prints above the bar what is printed meanwhile.
    with Progress(*columns, console=console, transient=True) as bar, showing_all():
        task = bar.add_task(visible(title), total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield update


def short(number: float) -> str:
    """Format a number with three digits and a prefix: ``13.5 M``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= factor:
            return f"{number / factor:.3g} {prefix}"
    return f"{number:.3g} "


def running_shell() -> Any:
    """The IPython that runs this process, or None."""
    ipython = sys.modules.get("IPython")
    return None if ipython is None else ipython.get_ipython()


def running_notebook() -> bool:
    """True if cells of a notebook are run, and not lines of a terminal."""
    return getattr(running_shell(), "kernel", None) is not None
