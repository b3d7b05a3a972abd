"""The command line ``djpt``: its commands, each in a file of its own, and how the process ends.

Exit codes, for scripts: 0 done; 1 a comparison found a difference; 2 wrong input; 3 this machine can't run
it (no usable LLVM, no Mitsuba to compare with); 130 interrupted; 143 terminated. Results go to stdout, errors and
the progress bar to stderr; the bar only to a terminal.
"""

# ruff: noqa: F401 (the names of commands are read by `lazily`)

from __future__ import annotations

import os
import sys
import warnings
from typing import TYPE_CHECKING

import click

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.core.files import reason
from djpt.core.lazy import lazily
from djpt.core.terminal import show_all
from djpt.errors import near_miss

if TYPE_CHECKING:
    from djpt.apps.cli.animation import animate as animate
    from djpt.apps.cli.animation import turntable as turntable
    from djpt.apps.cli.benchmarks import command as benchmarks
    from djpt.apps.cli.compare import command as compare
    from djpt.apps.cli.doctor import command as doctor
    from djpt.apps.cli.gradcheck import command as gradcheck
    from djpt.apps.cli.info import info as info
    from djpt.apps.cli.info import scenes as scenes
    from djpt.apps.cli.ladder import command as ladder
    from djpt.apps.cli.pictures import denoise as denoise
    from djpt.apps.cli.pictures import merge as merge
    from djpt.apps.cli.pictures import tonemap as tonemap
    from djpt.apps.cli.render import command as render
    from djpt.apps.cli.strips import bounces as bounces
    from djpt.apps.cli.strips import gallery as gallery
    from djpt.apps.cli.strips import spp as spp
    from djpt.apps.cli.strips import strategies as strategies
    from djpt.apps.cli.validate import command as validate
    from djpt.apps.cli.view import command as view
    from djpt.apps.cli.worker import command as worker

__all__ = ["COMMANDS", "app", "main", "run"]

command_named = lazily(__name__)[0]
"""The function that imports a command when it is asked for."""

COMMANDS = (
    *("render", "view", "worker", "merge", "denoise", "tonemap", "compare", "gradcheck", "validate"),
    *("info", "scenes", "gallery", "doctor", "benchmarks"),
    *("turntable", "animate", "ladder", "bounces", "spp", "strategies"),
)
"""The commands in the order of the help."""


class Commands(click.Group):
    """A group whose commands are imported when they are asked for: `djpt render` doesn't pay for the others."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return command_named(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            ctx.fail(f"unknown command '{args[0]}'{near_miss(args[0], COMMANDS)}")
        return super().resolve_command(ctx, args)


def print_version(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    """Print the version and end, if that is `wanted`."""
    if wanted:
        click.echo(f"djpt {djpt.__version__}")
        context.exit()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=print_version, help="Print the version."
)
def app() -> None:
    """A differentiable path tracer in pure Python over Dr.Jit that reads Mitsuba 3's scenes."""


def open_standard_streams() -> None:
    """Let standard streams that are missing (``2>&-``) lead to nowhere.

    The next file that is opened would take the number of one, and with it what is printed.
    """
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is taken.
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115 - as long as the process


def one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """The text of a warning without the line of the code that warns; for `warnings.formatwarning`."""
    return f"djpt: warning: {message}\n"


def main() -> int:
    """Run the command line and return the exit code."""
    try:
        app(prog_name="djpt")
    except SystemExit as end:  # how Click always ends
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    else:
        code = ExitCode.DONE
    return code if flushed() else ExitCode.BAD_INPUT


def flushed() -> bool:
    """True if all that was printed has arrived; prints an error if not, as on a full disk."""
    try:
        sys.stdout.flush()
    except OSError as error:
        print(f"djpt: error: can't write to the standard output: {reason(error)}", file=sys.stderr)
        # Python would try once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return False
    return True


def run() -> None:
    """Run `main`, and end the process with its exit code."""
    open_standard_streams()
    show_all()
    warnings.formatwarning = one_line
    code = main()
    if code == ExitCode.UNUSABLE:
        # Without an LLVM, Dr.Jit's own shutdown has been seen to hang.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)
