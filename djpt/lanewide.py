"""Loop state at full width."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import drjit as dr

from djpt.types import Bool

__all__ = ["wide"]


def wide(record: Any, lanes: int) -> Any:
    """A record with all fields at full width: loop state must not start as width-1 variables."""
    if record is None:
        return None
    if is_dataclass(record) and not isinstance(record, type):
        return type(record)(**{f.name: wide(getattr(record, f.name), lanes) for f in fields(record)})
    if isinstance(record, (list, tuple)):
        return type(record)(wide(entry, lanes) for entry in record)
    if not dr.is_array_v(record):
        return record
    if dr.is_mask_v(record):
        return record | dr.full(Bool, False, lanes)
    return record + dr.zeros(type(record), lanes)
