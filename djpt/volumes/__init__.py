"""Volumes of numbers and colours, one per file. The file registers its volume; one line here says where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.volumes.base import Volume as Volume
    from djpt.volumes.constvolume import ConstVolume as ConstVolume
    from djpt.volumes.gridvolume import GridVolume as GridVolume
    from djpt.volumes.volume_grid import VolumeGrid as VolumeGrid
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
