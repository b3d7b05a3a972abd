"""Indices of refraction of dielectrics, by name or number."""

from __future__ import annotations

from typing import Any, Final

import drjit as dr

from djpt.core.numeric import as_array, describe
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError, near_miss
from djpt.jit.frozen import recording

__all__ = ["IOR", "check_eta", "ior"]

IOR: Final = {
    "acetone": 1.36,
    "acrylic glass": 1.49,
    "air": 1.000277,
    "amber": 1.55,
    "benzene": 1.501,
    "bk7": 1.5046,
    "bromine": 1.661,
    "carbon dioxide": 1.00045,
    "carbon tetrachloride": 1.461,
    "diamond": 2.419,
    "ethanol": 1.361,
    "fused quartz": 1.458,
    "glycerol": 1.4729,
    "helium": 1.000036,
    "hydrogen": 1.000132,
    "pet": 1.575,
    "polypropylene": 1.49,
    "pyrex": 1.47,
    "silicone oil": 1.52045,
    "sodium chloride": 1.544,
    "vacuum": 1.0,
    "water": 1.333,
    "water ice": 1.31,
}
"""Indices for yellow light (589 nm) at 0 to 20 degrees Celsius, as in Mitsuba; most are from E. Hecht, "Optics"."""


def ior(props: Properties, key: str, default: str | float) -> float:
    """The index under `key`: one of the names in `IOR` (in any case), or a number > 0."""
    value = props.raw(key, default)
    if not isinstance(value, str):
        return props.float(key, low=0.0, low_open=True) if key in props else float(value)
    name = value.lower()
    if name not in IOR:
        raise props.error(key, f"must be a number or the name of a medium, found '{value}'{near_miss(name, IOR)}")
    return IOR[name]


def check_eta(value: Any) -> Any:
    """Return `value`, about to be assigned to a relative index; raise `ParameterError` unless it is > 0."""
    if recording():
        return value
    try:
        positive = (as_array(dr.detach(value) if dr.is_array_v(value) else value) > 0).all()
    except SceneError as error:
        raise ParameterError(str(error)) from None
    if not positive:
        raise ParameterError(f"must be greater than 0, found {describe(value)}")
    return value
