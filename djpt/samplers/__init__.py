"""Samplers, one per file. The file registers its sampler; one line here imports it."""

from djpt.samplers.base import SampleIndex as SampleIndex
from djpt.samplers.base import Sampler as Sampler
from djpt.samplers.base import SampleStream as SampleStream
from djpt.samplers.independent import Independent as Independent
from djpt.samplers.ldsampler import LDSampler as LDSampler
from djpt.samplers.multijitter import Multijitter as Multijitter
from djpt.samplers.orthogonal import Orthogonal as Orthogonal
from djpt.samplers.sobol import Sobol as Sobol
from djpt.samplers.stratified import Stratified as Stratified

__all__ = [name for name, value in globals().items() if isinstance(value, type)]
