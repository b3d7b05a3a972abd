"""The public names of Mitsuba, compared with djpt's: which are here, differ, are left out, are absent.

The command ``python -m djpt.validation.names`` prints the shares; with ``--write`` it renews the page of the
documentation.
"""

from __future__ import annotations

from djpt.validation.names.compare import (
    Finding,
    PublicName,
    Verdict,
    counts,
    findings,
    public_names,
    read_names,
    render_page,
)

__all__ = ["Finding", "PublicName", "Verdict", "counts", "findings", "public_names", "read_names", "render_page"]
