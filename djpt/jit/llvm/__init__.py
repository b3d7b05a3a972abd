"""The LLVM library behind Dr.Jit's CPU backend: its search and its installation.

`finder` chooses among the libraries of this machine; ``python -m djpt.jit.llvm`` (`installer`)
puts a private copy into the Python environment where there is none. Nothing here imports
Dr.Jit, since the choice must be made first.
"""

from __future__ import annotations

from djpt.jit.llvm.finder import MINIMUM, PATH_VARIABLE, SEARCH_VARIABLE, Candidate, Search, prepare, search

__all__ = ["MINIMUM", "PATH_VARIABLE", "SEARCH_VARIABLE", "Candidate", "Search", "prepare", "search"]
