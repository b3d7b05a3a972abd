"""Parts that all commands share: exit codes, and errors as one line."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Any

import click

from djpt.core.files import reason
from djpt.core.interruption import Terminated
from djpt.core.terminal import visible
from djpt.errors import BackendError, DjptError, RenderError, SceneError
from djpt.jit.backends import VARIANTS
from djpt.jit.llvm.finder import libatomic_missing, prepare

__all__ = [
    "Command",
    "ExitCode",
    "announce",
    "described_scene",
    "fail",
    "number_or_word",
    "parameters",
    "require_positive",
    "say",
]


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

    def __init__(self, *arguments: Any, renders: bool = True, **options: Any) -> None:
        """`renders`: the command uses the backend, and fetches LLVM where this machine has none."""
        super().__init__(*arguments, **options)
        self._renders = renders

    def invoke(self, ctx: click.Context) -> Any:
        with readable_errors():
            if self._renders:
                provide_backend()
            return super().invoke(ctx)

    def get_short_help_str(self, limit: int = 45) -> str:
        """The first sentence of the help, which Click would cut off."""
        return (self.help or "").partition("\n")[0]


def provide_backend() -> None:
    """Fetch what the CPU backend lacks on this machine, if that is allowed: see `djpt.jit.llvm.installer`."""
    on_gpu = VARIANTS.get(os.environ.get("DJPT_VARIANT", "")) == "cuda"
    if not on_gpu and (prepare().chosen is None or libatomic_missing()):
        from djpt.jit.llvm.installer import provide

        provide()


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


def described_scene(scene: str, define: Sequence[str], **changes: Any) -> tuple[str, dict[str, Any]]:
    """The name and the description of SCENE with the parameters of ``-D``, changed as by `djpt.scenes.override`.

    The sizes among the changes must be positive. NumPy and Dr.Jit are imported after the scene was found.
    """
    from djpt.scenes.overrides import described, override

    require_positive(**{name: changes[name] for name in ("width", "height") if name in changes})
    name, description = described(scene, parameters(define))
    return name, override(description, **changes)


def require_positive(**options: float | None) -> None:
    """End with an error if one of the options is below 1."""
    for name, value in options.items():
        if value is not None and value < 1:
            raise RenderError(f"--{name.replace('_', '-')} must be at least 1, found {value}")


def announce(line: str) -> None:
    """Print a line of progress at once, for a file or a pipe, where no bar is shown."""
    print(visible(line), file=sys.stderr, flush=True)


def say(line: str) -> None:
    """Print a line of results, which stays one line whatever names it has."""
    print(visible(line))
