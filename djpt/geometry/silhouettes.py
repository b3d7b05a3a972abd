"""Mitsuba's names for silhouettes, which djpt hasn't, and why."""

from __future__ import annotations

__all__ = ["missing"]

SILHOUETTES = (
    "differential_motion",
    "invert_silhouette_sample",
    "precompute_silhouette",
    "primitive_silhouette_projection",
    "sample_precomputed_silhouette",
    "sample_silhouette",
    "silhouette_discontinuity_types",
)


def missing(owner: object, name: str) -> AttributeError:
    """The error for an attribute that `owner` hasn't; of names about silhouettes it says what to do."""
    text = f"'{type(owner).__name__}' object has no attribute '{name}'"
    if name in SILHOUETTES:
        text += (
            ": there are no derivatives by geometry, so silhouettes aren't sampled; differentiate by materials, lights "
        )
        text += "and textures, or take differences"
    return AttributeError(text, name=name, obj=owner)
