"""Reconstruction filters: one file each, one registration line each."""

from djpt.description.registry import register_rfilter
from djpt.rfilters.base import ReconstructionFilter
from djpt.rfilters.box import Box
from djpt.rfilters.cubic import CatmullRom, Mitchell
from djpt.rfilters.gaussian import Gaussian
from djpt.rfilters.lanczos import Lanczos
from djpt.rfilters.tent import Tent

__all__ = ["Box", "CatmullRom", "Gaussian", "Lanczos", "Mitchell", "ReconstructionFilter", "Tent"]

register_rfilter("box", Box)
register_rfilter("tent", Tent)
register_rfilter("gaussian", Gaussian)
register_rfilter("mitchell", Mitchell)
register_rfilter("catmullrom", CatmullRom)
register_rfilter("lanczos", Lanczos)
