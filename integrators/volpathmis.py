"""The path tracer for coloured media."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.volpath import VolumetricPath

__all__ = ["VolumetricPathMIS"]


class VolumetricPathMIS(VolumetricPath):
    """`volpath` with spectral multiple importance sampling.

    In `volpath` one channel's extinction samples all distances of a path, and the density is that of this channel
    alone, so the others may get large weights. Here every flight draws its channel anew, those more often in which much
    light is left or which are dense, and the density is that of all channels together: no channel can outgrow the
    others. Where no medium is coloured, draws are those of `volpath`.

    Parameters: those of `volpath`, and `use_spectral_mis` (default true; false: `volpath` itself).

    A. Wilkie et al., "Hero Wavelength Spectral Sampling", EGSR 2014; B. Miller, I. Georgiev and W. Jarosz, "A Null-
    Scattering Path Integral Formulation of Light Transport", SIGGRAPH 2019.
    """

    pure = True
    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.spectral_mis = props.boolean("use_spectral_mis", True)


register_integrator("volpathmis", VolumetricPathMIS)
