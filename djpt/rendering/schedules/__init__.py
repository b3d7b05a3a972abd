"""Schedules: how the samples of an image are distributed to lanes of a kernel, one way per file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.rendering.schedules.flat import Flat as Flat
    from djpt.rendering.schedules.learning import Learning as Learning
    from djpt.rendering.schedules.machine import Machine as Machine
    from djpt.rendering.schedules.media_machine import MediaMachine as MediaMachine
    from djpt.rendering.schedules.photons import Photons as Photons
    from djpt.rendering.schedules.progressive import Progressive as Progressive
    from djpt.rendering.schedules.splatting import Splatting as Splatting
    from djpt.rendering.schedules.wave import Wave as Wave
    from djpt.rendering.schedules.wavefront import Wavefront as Wavefront
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
