"""Reconstruction filters, one per file. The file registers its filter; one line here imports it."""

from djpt.rfilters.base import ReconstructionFilter as ReconstructionFilter
from djpt.rfilters.box import Box as Box
from djpt.rfilters.cubic import CatmullRom as CatmullRom
from djpt.rfilters.cubic import Mitchell as Mitchell
from djpt.rfilters.gaussian import Gaussian as Gaussian
from djpt.rfilters.lanczos import Lanczos as Lanczos
from djpt.rfilters.tent import Tent as Tent

__all__ = [name for name, value in globals().items() if isinstance(value, type)]
