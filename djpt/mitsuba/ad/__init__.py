"""Optimisers under the name that Mitsuba scripts use, those of `drjit.opt`, and what else its `ad` holds.

opt = djpt.mitsuba.ad.Adam(lr=0.05, params={key: params[key]})
"""

# ruff: noqa: F401 (the names are read by `lazily`)

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.integrators.projective import detail as projective
    from djpt.integrators.projective import guiding as guiding
    from djpt.integrators.projective.detail import ProjectiveDetail as ProjectiveDetail
    from djpt.integrators.projective.guiding import BaseGuidingDistr as BaseGuidingDistr
    from djpt.integrators.projective.guiding import GridDistr as GridDistr
    from djpt.integrators.projective.guiding import OcSpaceDistr as OcSpaceDistr
    from djpt.integrators.projective.guiding import UniformDistr as UniformDistr
    from djpt.mitsuba.ad import integrators as integrators
    from djpt.mitsuba.ad import largesteps as largesteps
    from djpt.mitsuba.ad import loaders as loaders
    from djpt.mitsuba.ad import optimizers as optimizers
    from djpt.mitsuba.ad.integrators import common as common
    from djpt.mitsuba.ad.integrators import prb as prb
    from djpt.mitsuba.ad.integrators import prb_basic as prb_basic
    from djpt.mitsuba.ad.largesteps import LargeSteps as LargeSteps
    from djpt.mitsuba.ad.loaders import ray_loader as ray_loader
    from djpt.mitsuba.ad.loaders.ray_loader import FlatSensor as FlatSensor
    from djpt.mitsuba.ad.loaders.ray_loader import RayDataLoader as RayDataLoader
    from djpt.mitsuba.ad.optimizers import SGD as SGD
    from djpt.mitsuba.ad.optimizers import Adam as Adam
    from djpt.mitsuba.ad.optimizers import AdamW as AdamW
    from djpt.mitsuba.ad.optimizers import GradScaler as GradScaler
    from djpt.mitsuba.ad.optimizers import Optimizer as Optimizer
    from djpt.mitsuba.ad.optimizers import RMSProp as RMSProp
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
