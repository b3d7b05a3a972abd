"""The contract between plugins and working frames: see `Plugin.move_into`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from djpt.errors import DjptError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Frame", "NotMovable"]


class NotMovable(DjptError):
    """A plugin that can't be moved into a frame: what it does in other coordinates isn't known."""


class Frame(Protocol):
    """The map p -> scale (p - center) from the scene's own coordinates, as plugins see it that move along.

    Radiance and irradiance stay as they are. What goes with a power of the unit of length follows that power of the
    scale: the intensity of lights without size its square, what media do per unit of length its inverse.
    """

    @property
    def scale(self) -> float:
        """The length of the unit in the frame: a power of two."""

    def point(self, p: Any) -> NDArray[np.float64]:
        """Points (3,) or (N, 3) of the scene, in the frame."""

    def moved(self, to_world: Any) -> Any:
        """The `to_world` in the frame of something that has a size."""

    def moved_unscaled(self, to_world: Any) -> Any:
        """The `to_world` in the frame of something without a size, such as a camera."""

    def rescaled(self, plugin: Any, power: int) -> Any:
        """A texture or volume times a power of the scale; itself for a scale of 1, and None for None."""

    def copy_of(self, plugin: Any) -> Any:
        """A nested plugin in the frame: a copy, always the same, or itself if nothing in it differs there.

        What isn't a plugin is returned as it is.

        Raises:
            NotMovable: it can't be moved.
        """

    def copied(self, plugin: Any) -> Any:
        """A copy of a plugin that hasn't moved.

        Raises:
            NotMovable: its class doesn't say how it moves.
        """
