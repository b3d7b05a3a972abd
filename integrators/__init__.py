"""Light transport, one estimator per file. The file registers its integrator; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if __name__ != "djpt.integrators":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.integrators instead")

if TYPE_CHECKING:
    from djpt.integrators.aov import AOV as AOV
    from djpt.integrators.base import Integrator as Integrator
    from djpt.integrators.base import PathIntegrator as PathIntegrator
    from djpt.integrators.base import PathState as PathState
    from djpt.integrators.base import Vertex as Vertex
    from djpt.integrators.bdpt import BidirectionalPath as BidirectionalPath
    from djpt.integrators.bidirectional.strategies import SplattingIntegrator as SplattingIntegrator
    from djpt.integrators.depth import Depth as Depth
    from djpt.integrators.direct import Direct as Direct
    from djpt.integrators.direct_projective import DirectProjectiveIntegrator as DirectProjectiveIntegrator
    from djpt.integrators.distributed import Distributed as Distributed
    from djpt.integrators.guided import GuidedPath as GuidedPath
    from djpt.integrators.guiding.training import LearningIntegrator as LearningIntegrator
    from djpt.integrators.mmlt import MultiplexedMetropolis as MultiplexedMetropolis
    from djpt.integrators.moment import Moment as Moment
    from djpt.integrators.path import Path as Path
    from djpt.integrators.path_naive import PathNaive as PathNaive
    from djpt.integrators.path_nee import PathNEE as PathNEE
    from djpt.integrators.paths.passes import PassIntegrator as PassIntegrator
    from djpt.integrators.paths.unidirectional import UnidirectionalPath as UnidirectionalPath
    from djpt.integrators.photons.photon_mapping import PhotonMapping as PhotonMapping
    from djpt.integrators.prb import PRB as PRB
    from djpt.integrators.prb_basic import PRBBasic as PRBBasic
    from djpt.integrators.prb_projective import PathProjectiveIntegrator as PathProjectiveIntegrator
    from djpt.integrators.prbvolpath import PRBVolumetricPath as PRBVolumetricPath
    from djpt.integrators.ptracer import ParticleTracer as ParticleTracer
    from djpt.integrators.raycast import Raycast as Raycast
    from djpt.integrators.sppm import StochasticProgressivePhotonMapping as StochasticProgressivePhotonMapping
    from djpt.integrators.upbp import UnifiedPointsBeamsPaths as UnifiedPointsBeamsPaths
    from djpt.integrators.vcm import VertexConnectionMerging as VertexConnectionMerging
    from djpt.integrators.volpath import VolumetricPath as VolumetricPath
    from djpt.integrators.volpathcache import CachedVolumetricPath as CachedVolumetricPath
    from djpt.integrators.volpathmis import VolumetricPathMIS as VolumetricPathMIS
    from djpt.integrators.volprim_rf_basic import (
        BasicVolumetricPrimitiveRadianceFieldIntegrator as BasicVolumetricPrimitiveRadianceFieldIntegrator,
    )
    from djpt.integrators.whitted import Whitted as Whitted
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
