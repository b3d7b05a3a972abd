"""``python -m djpt``: the command line, as the ``djpt`` script."""

from __future__ import annotations

import sys

from djpt.cli import main

if __name__ == "__main__":
    sys.exit(main())
