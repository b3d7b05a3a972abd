"""Reconstruction filters, one per file. The file registers its filter; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.rfilters.base import ReconstructionFilter as ReconstructionFilter
    from djpt.rfilters.box import Box as Box
    from djpt.rfilters.cubic import CatmullRom as CatmullRom
    from djpt.rfilters.cubic import Mitchell as Mitchell
    from djpt.rfilters.gaussian import Gaussian as Gaussian
    from djpt.rfilters.lanczos import Lanczos as Lanczos
    from djpt.rfilters.tent import Tent as Tent
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
