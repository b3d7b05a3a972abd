"""Light transport: one estimator per file, one registration line each."""

from __future__ import annotations

if __name__ != "djpt.integrators":  # a second copy of every class would be made
    raise ImportError(f"{__name__!r} is part of djpt: import djpt.integrators instead")

from djpt.description.registry import register_integrator
from djpt.integrators.aov import AOV
from djpt.integrators.base import Integrator, PathIntegrator, PathState, Vertex
from djpt.integrators.depth import Depth
from djpt.integrators.direct import Direct
from djpt.integrators.distributed import Distributed
from djpt.integrators.moment import Moment
from djpt.integrators.path import Path
from djpt.integrators.path_naive import PathNaive
from djpt.integrators.path_nee import PathNEE
from djpt.integrators.prb import PRB
from djpt.integrators.prb_basic import PRBBasic
from djpt.integrators.ptracer import ParticleTracer
from djpt.integrators.raycast import Raycast
from djpt.integrators.unidirectional import UnidirectionalPath
from djpt.integrators.whitted import Whitted

__all__ = [
    "AOV",
    "PRB",
    "Depth",
    "Direct",
    "Distributed",
    "Integrator",
    "Moment",
    "PRBBasic",
    "ParticleTracer",
    "Path",
    "PathIntegrator",
    "PathNEE",
    "PathNaive",
    "PathState",
    "Raycast",
    "UnidirectionalPath",
    "Vertex",
    "Whitted",
]

register_integrator("raycast", Raycast)
register_integrator("whitted", Whitted)
register_integrator("distributed", Distributed)
register_integrator("path", Path)
register_integrator("path_naive", PathNaive)
register_integrator("path_nee", PathNEE)
register_integrator("prb", PRB)
register_integrator("prb_basic", PRBBasic)
register_integrator("ptracer", ParticleTracer)
register_integrator("direct", Direct)
register_integrator("depth", Depth)
register_integrator("aov", AOV)
register_integrator("moment", Moment)
