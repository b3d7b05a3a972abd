"""All closed forms."""

from __future__ import annotations

from djpt.validation.closed_forms.base import ClosedForm
from djpt.validation.closed_forms.floors import FLOORS
from djpt.validation.closed_forms.glass import GLASS
from djpt.validation.closed_forms.matter import MATTER
from djpt.validation.closed_forms.rooms import ROOMS

__all__ = ["CASES", "ClosedForm"]

CASES: dict[str, ClosedForm] = {case.name: case for case in (*FLOORS, *ROOMS, *GLASS, *MATTER)}
"""The closed forms by name."""
