"""Phase functions, one per file. The file registers its phase function; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.phase.base import PhaseFunction as PhaseFunction
    from djpt.phase.blendphase import BlendPhaseFunction as BlendPhaseFunction
    from djpt.phase.hg import HGPhaseFunction as HGPhaseFunction
    from djpt.phase.isotropic import IsotropicPhaseFunction as IsotropicPhaseFunction
    from djpt.phase.rayleigh import RayleighPhaseFunction as RayleighPhaseFunction
    from djpt.phase.sggx import SGGXPhaseFunction as SGGXPhaseFunction
    from djpt.phase.tabphase import TabulatedPhaseFunction as TabulatedPhaseFunction
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
