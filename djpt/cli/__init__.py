"""The command line ``djpt``."""

from __future__ import annotations

__all__ = ["run"]


def run() -> None:
    """Run the command line: see `djpt.cli.commands`."""
    from djpt.cli.commands import run

    run()
