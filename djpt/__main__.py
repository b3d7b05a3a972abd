"""``python -m djpt``: the command line, as the ``djpt`` script."""

from __future__ import annotations

from djpt.apps.cli.main import run

if __name__ == "__main__":
    run()
