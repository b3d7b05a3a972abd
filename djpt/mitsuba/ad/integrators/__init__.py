"""The modules of differentiable integrators under Mitsuba's paths, for scripts to use or to derive from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.integrators import direct_projective as direct_projective
    from djpt.integrators import prb_projective as prb_projective
    from djpt.integrators import volprim_rf_basic as volprim_rf_basic
    from djpt.mitsuba.ad.integrators import common as common
    from djpt.mitsuba.ad.integrators import prb as prb
    from djpt.mitsuba.ad.integrators import prb_basic as prb_basic
    from djpt.mitsuba.ad.integrators import prbvolpath as prbvolpath
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
