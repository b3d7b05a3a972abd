"""Bounds that follow from the meaning of a parameter."""

from __future__ import annotations

from math import inf

from djpt.description.parameters import SceneParameters

__all__ = ["usual_bounds"]

Bounds = tuple[float, float]

SHARE: Bounds = (0.0, 1.0)
POSITIVE: Bounds = (0.0, inf)
ANY: Bounds = (-inf, inf)

OF_KIND: dict[str, Bounds] = {
    "bsdf": SHARE,
    "emitter": POSITIVE,
    "medium": POSITIVE,
    "phase": SHARE,
    "shape": ANY,
    "sensor": ANY,
}
"""The bounds of parameters, by the kind of the innermost plugin among these that they belong to."""

BY_NAME: dict[tuple[str, str], Bounds] = {
    ("bsdf", "eta"): POSITIVE,
    ("bsdf", "k"): POSITIVE,
    ("bsdf", "to_uv"): ANY,
    ("emitter", "position"): ANY,
    ("emitter", "to_world"): ANY,
    ("medium", "albedo"): SHARE,
    ("medium", "to_world"): ANY,
    ("phase", "g"): (-0.999, 0.999),
}
"""Exceptions, by the kind and a part of the parameter's name."""


def usual_bounds(params: SceneParameters, key: str) -> Bounds:
    """The values that make sense for a parameter, (low, high), ends included.

    * of materials: 0 to 1, as for albedos and roughness; indices of refraction, `eta` and `k`: 0 to infinity;
    * of lights: 0 to infinity; of media likewise, but for their `albedo`, 0 to 1; `g` of a phase function: -0.999 to
      0.999;
    * of shapes and sensors, and transforms: unbounded.

    The values of a texture or a volume count as those of the plugin that uses it.

    Raises:
        ParameterError: There is no such parameter.
    """
    names = key.split(".")
    for plugin in params.owners(key):
        if plugin.kind in OF_KIND:
            exceptions = (BY_NAME.get((plugin.kind, name)) for name in names)
            return next((bounds for bounds in exceptions if bounds is not None), OF_KIND[plugin.kind])
    return ANY
