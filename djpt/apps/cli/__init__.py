"""The command line ``djpt``."""

from __future__ import annotations

__all__ = ["run"]


def run() -> None:
    """Run the command line: see `djpt.apps.cli.main`."""
    from djpt.apps.cli.main import run

    run()
