"""The path tracer for coloured media."""

from __future__ import annotations

from djpt.description.properties import Properties
from djpt.description.registry import register_integrator
from djpt.integrators.volpath import VolumetricPath

__all__ = ["VolumetricPathMIS"]


class VolumetricPathMIS(VolumetricPath):
    """`volpath` with spectral multiple importance sampling.

    One channel's extinction samples all distances of a path. `volpath` divides by the density of that channel alone,
    so the others may get large weights. Here the density is the mean over the channels, of the whole path: that of
    having drawn any of them. No weight is larger than three times that of the best channel.

    Parameters: those of `volpath`, and `use_spectral_mis` (default true; false: `volpath` itself).

    A. Wilkie et al., "Hero Wavelength Spectral Sampling", EGSR 2014; B. Miller, I. Georgiev and W. Jarosz, "A Null-
    Scattering Path Integral Formulation of Light Transport", SIGGRAPH 2019.
    """

    in_any_frame = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.spectral_mis = props.boolean("use_spectral_mis", True)


register_integrator("volpathmis", VolumetricPathMIS)
