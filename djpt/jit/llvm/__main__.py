"""The command ``python -m djpt.jit.llvm``: see `djpt.jit.llvm.installer`."""

from __future__ import annotations

import sys

from djpt.core.terminal import show_all
from djpt.jit.llvm.installer import main

if __name__ == "__main__":
    show_all()
    sys.exit(main())
