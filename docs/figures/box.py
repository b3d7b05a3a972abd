"""The Cornell box."""

from __future__ import annotations

import djpt
from djpt.images.sheets import captioned_sheet
from djpt.validation.integrator_comparison.strips import samples
from places import IMAGES

__all__ = ["cornell_box", "spp"]


def cornell_box() -> None:
    """The Cornell box, as `djpt render cornell_box` makes it, with more pixels and samples."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=400, height=400)
    image = djpt.render(djpt.load_dict(description), spp=2048)
    djpt.write(IMAGES / "cornell_box.png", image)


def spp() -> None:
    """What `djpt spp cornell_box` makes: noise by the number of samples."""
    djpt.write(IMAGES / "spp.png", captioned_sheet(samples("cornell_box", width=160)))
