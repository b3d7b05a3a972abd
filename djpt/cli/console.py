"""Parts that all commands share: options, exit codes, errors as one line, the progress bar."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from djpt.errors import BackendError, DjptError, RenderError, SceneError

if TYPE_CHECKING:
    from rich.progress import Task
    from rich.text import Text

__all__ = [
    "Defines",
    "ExitCode",
    "Exposure",
    "Quiet",
    "SceneName",
    "Seed",
    "Width",
    "announce",
    "fail",
    "has_terminal",
    "number_or_word",
    "parameters",
    "progress_bar",
    "readable_errors",
    "require_positive",
    "short",
]


FORCE_TERMINAL = frozenset({"FORCE_COLOR", "TTY_COMPATIBLE"})
"""Variables by which `rich` takes something else for a terminal."""


class ExitCode(IntEnum):
    """The exit codes of the process."""

    DONE = 0
    DIFFERENT = 1
    BAD_INPUT = 2
    UNUSABLE = 3
    INTERRUPTED = 130


def scenes_like(incomplete: str) -> list[str]:
    """The built-in scenes, XML files and folders that begin with what was typed, for completion in shells."""
    from djpt.scenes import NAMES

    folder, _, begin = incomplete.rpartition("/")
    try:
        entries = sorted(
            os.scandir(folder or ("/" if incomplete.startswith("/") else ".")), key=lambda entry: entry.name
        )
    except OSError:
        entries = []
    prefix = incomplete[: len(incomplete) - len(begin)]
    files = [
        f"{prefix}{entry.name}{'/' if entry.is_dir() else ''}"
        for entry in entries
        if entry.name.startswith(begin) and (entry.is_dir() or entry.name.endswith(".xml"))
    ]
    return [name for name in NAMES if name.startswith(incomplete)] + files


SceneName = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="An XML file, or a built-in scene; see 'djpt scenes'.",
        autocompletion=scenes_like,
    ),
]
Seed = Annotated[int, typer.Option(help="Seed: the same one gives the same image.")]
Width = Annotated[int | None, typer.Option(help="Pixels; keeps the shape unless --height is given.")]
Defines = Annotated[
    list[str] | None, typer.Option("-D", metavar="NAME=VALUE", help="A parameter of the XML file; may be repeated.")
]
Exposure = Annotated[
    str, typer.Option(metavar="STOPS", help="Brightness in stops: a number, or 'auto'; for png and jpg.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


@contextlib.contextmanager
def readable_errors() -> Iterator[None]:
    """Turn errors that a user can cause into one line and an exit code, without a traceback."""
    try:
        yield
    except BackendError as error:
        fail(str(error), ExitCode.UNUSABLE)  # several lines: the advice has its own
    except DjptError as error:
        fail(" ".join(str(error).split()), ExitCode.BAD_INPUT)
    except MemoryError:
        fail("out of memory", ExitCode.BAD_INPUT)
    except KeyboardInterrupt:
        fail("interrupted", ExitCode.INTERRUPTED)


def fail(message: str, code: ExitCode) -> None:
    """Print an error and end the process."""
    print(f"djpt: error: {message}", file=sys.stderr)
    raise typer.Exit(code) from None


def number_or_word(text: str) -> float | str:
    """Parse a number; any other text stays as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def parameters(definitions: list[str] | None) -> dict[str, str]:
    """Parse the parameters of ``-D name=value``; the last one of a name counts."""
    pairs = [definition.partition("=") for definition in definitions or ()]
    for name, equals, value in pairs:
        if not name or not equals:
            raise SceneError(f"-D takes NAME=VALUE, found '{name}{equals}{value}'")
    return {name: value for name, _, value in pairs}


def require_positive(**options: float | None) -> None:
    """End with an error if one of the options is below 1."""
    for name, value in options.items():
        if value is not None and value < 1:
            raise RenderError(f"--{name.replace('_', '-')} must be at least 1, found {value}")


def has_terminal() -> bool:
    """Whether there is a terminal to show progress on."""
    return sys.stderr.isatty() or bool(set(os.environ) & FORCE_TERMINAL)


def announce(line: str) -> None:
    """Print a line of progress at once, for a file or a pipe, where no bar is shown."""
    print(line, file=sys.stderr, flush=True)


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

    console = Console(stderr=True)
    if not console.is_terminal:
        yield nothing
        return

    class Speed(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{short(task.speed)}{unit}/s")

    columns: list[Any] = [TextColumn(title), BarColumn(), TaskProgressColumn(), Speed(), TimeRemainingColumn()]
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield update


def short(number: float) -> str:
    """Format a number with three digits and a prefix: ``13.5 M``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= factor:
            return f"{number / factor:.3g} {prefix}"
    return f"{number:.3g} "
