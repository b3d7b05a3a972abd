"""Where the names for scripts are defined: the table that `djpt` looks them up in."""

from __future__ import annotations

__all__ = ["EXPORTS", "SUBMODULES"]

EXPORTS: dict[str, str] = {
    "djpt.films.base": "Film FilmFlags",
    "djpt.films.image_block": "ImageBlock",
    "djpt.integrators.base": "SamplingIntegrator",
    "djpt.integrators.unidirectional": "MonteCarloIntegrator",
    "djpt.rfilters.base": "ReconstructionFilter",
    "djpt.samplers.base": "Sampler",
    "djpt.scripting.adjoint_integrators": "AdjointIntegrator",
    "djpt.scripting.plugin_kinds": (
        "Endpoint Medium PhaseFunction Volume register_medium register_phasefunction register_volume"
    ),
    "djpt.sensors.base": "Sensor",
    "djpt.sensors.projective": "ProjectiveCamera",
    "djpt.shapes.base": "Shape",
    "djpt.textures.base": "Texture",
}
"""The modules of names that are attributes of `djpt`, each with its names, separated by spaces."""

SUBMODULES: dict[str, str] = {}
"""Attributes of `djpt` that are modules, with the modules that they stand for."""
