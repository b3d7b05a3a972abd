"""The command line ``djpt``."""

from __future__ import annotations

__all__ = ["run"]


def run() -> None:
    """Run the command line: see `djpt.cli.main`."""
    from djpt.cli.main import run

    run()
