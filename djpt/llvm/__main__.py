"""The command ``python -m djpt.llvm``: see `djpt.llvm.installer`."""

from __future__ import annotations

import sys

from djpt.cli.terminal import show_all
from djpt.llvm.installer import main

if __name__ == "__main__":
    show_all()
    sys.exit(main())
