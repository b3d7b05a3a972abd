"""Samplers, one per file. The file registers its sampler; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.samplers.base import SampleIndex as SampleIndex
    from djpt.samplers.base import Sampler as Sampler
    from djpt.samplers.base import SampleStream as SampleStream
    from djpt.samplers.base import WavefrontIndex as WavefrontIndex
    from djpt.samplers.independent import Independent as Independent
    from djpt.samplers.ldsampler import LDSampler as LDSampler
    from djpt.samplers.multijitter import Multijitter as Multijitter
    from djpt.samplers.orthogonal import Orthogonal as Orthogonal
    from djpt.samplers.sobol import Sobol as Sobol
    from djpt.samplers.stratified import Stratified as Stratified
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
