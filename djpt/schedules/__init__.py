"""Schedules: how the samples of an image are distributed to lanes of a kernel, one way per file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.lazy import lazily

if TYPE_CHECKING:
    from djpt.schedules.flat import Flat as Flat
    from djpt.schedules.learning import Learning as Learning
    from djpt.schedules.machine import Machine as Machine
    from djpt.schedules.media_machine import MediaMachine as MediaMachine
    from djpt.schedules.photons import Photons as Photons
    from djpt.schedules.progressive import Progressive as Progressive
    from djpt.schedules.splatting import Splatting as Splatting
    from djpt.schedules.wave import Wave as Wave
    from djpt.schedules.wavefront import Wavefront as Wavefront
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
