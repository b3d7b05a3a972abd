"""djpt: a differentiable path tracer in pure Python over Dr.Jit."""

from __future__ import annotations

from djpt.llvm.finder import prepare as _prepare

# Before anything can import Dr.Jit, also the user's own `import mitsuba` on the next line.
_prepare()

__version__ = "0.1.0"
