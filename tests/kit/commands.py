"""The command line, called without a process of its own."""

from __future__ import annotations

from click.testing import CliRunner

from djpt.apps.cli.main import app

__all__ = ["run"]


def run(*arguments: str) -> tuple[int, str, str]:
    """Run ``djpt`` with some arguments: the exit code, stdout, stderr. Other exceptions than exits are failures."""
    result = CliRunner().invoke(app, list(arguments))
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr
