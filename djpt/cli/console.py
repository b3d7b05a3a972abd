"""Parts that all commands share: exit codes, errors as one line, the progress bar."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import click

from djpt.cli.terminal import beneath, showing_all, visible
from djpt.errors import BackendError, DjptError, RenderError, SceneError
from djpt.files import reason
from djpt.process.interruption import Terminated

if TYPE_CHECKING:
    from rich.progress import Task
    from rich.text import Text

__all__ = [
    "Command",
    "ExitCode",
    "announce",
    "fail",
    "has_terminal",
    "number_or_word",
    "parameters",
    "progress_bar",
    "readable_errors",
    "require_positive",
    "say",
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
    TERMINATED = 143


class Command(click.Command):
    """A command whose errors that a user can cause are one line and an exit code, without a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        with readable_errors():
            return super().invoke(ctx)

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first sentence of the help, which Click would cut off."""
        return (self.help or "").partition("\n")[0]


@contextlib.contextmanager
def readable_errors() -> Iterator[None]:
    """Turn errors that a user can cause into one line and an exit code, without a traceback."""
    try:
        yield
    except BackendError as error:
        fail(str(error), ExitCode.UNUSABLE)  # several lines: the advice has its own
    except DjptError as error:
        fail(" ".join(str(error).split()), ExitCode.BAD_INPUT)
    except BrokenPipeError:
        raise  # whoever reads the output has seen enough: Click ends quietly
    except OSError as error:  # files have errors of their own
        what = "can't write to the standard output" if error.filename is None else f"'{error.filename}'"
        fail(f"{what}: {reason(error)}", ExitCode.BAD_INPUT)
    except MemoryError:
        fail("out of memory", ExitCode.BAD_INPUT)
    except KeyboardInterrupt as end:
        fail(str(end) or "interrupted", ExitCode.INTERRUPTED)
    except Terminated as end:
        fail(str(end), ExitCode.TERMINATED)


def fail(message: str, code: ExitCode) -> None:
    """Print an error and end the process."""
    print(f"djpt: error: {message}", file=sys.stderr)
    raise click.exceptions.Exit(code) from None


def number_or_word(text: str) -> float | str:
    """Parse a number; any other text stays as it is."""
    try:
        return float(text)
    except ValueError:
        return text


def parameters(definitions: Sequence[str]) -> dict[str, str]:
    """Parse the parameters of ``-D name=value``; the last one of a name counts."""
    pairs = [definition.partition("=") for definition in definitions]
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
    """True if there is a terminal to show progress on."""
    return sys.stderr.isatty() or bool(set(os.environ) & FORCE_TERMINAL)


def announce(line: str) -> None:
    """Print a line of progress at once, for a file or a pipe, where no bar is shown."""
    print(visible(line), file=sys.stderr, flush=True)


def say(line: str) -> None:
    """Print a line of results, which stays one line whatever names it has."""
    print(visible(line))


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
