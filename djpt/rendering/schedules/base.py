"""The contract of schedules."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, ClassVar

from djpt.dispatch.ensemble import Detached
from djpt.errors import RenderError
from djpt.jit.types import Float, TensorXf, UInt32
from djpt.rendering.schedules.job import Band, Job
from djpt.rendering.schedules.passes import stored_rows
from djpt.rendering.schedules.reconstruction import Summed, image_of_rows

if TYPE_CHECKING:
    from djpt.rendering.gradients.leaves import Numbering
    from djpt.rendering.gradients.modes import Mode

__all__ = ["ModeOf", "Schedule"]

ModeOf = Callable[[int, UInt32], Any]
"""Makes the `Mode` of a replay for a number of lanes, and for the pixel of each lane if it has one pixel only."""


class Schedule:
    """A way to fill lanes with the samples of an image.

    All schedules compute the same samples from the same random numbers: their images agree to rounding.
    """

    name: ClassVar[str]

    in_bands: ClassVar[bool] = True
    """Whether the image is computed from top to bottom, and there are `rows`; if not, all of it at once."""

    can_be_recorded: ClassVar[bool] = True
    """Whether the kernels of `rows` can be launched again without Python (`dr.freeze`)."""

    def image(self, job: Job) -> TensorXf:
        """The image of a job, (height, width, channels), without derivatives."""
        return image_of_rows(job, self.rows(job))

    def rows(self, job: Job) -> Iterator[Summed]:
        """The sums of a job's image, top to bottom, in bands: the memory of one band is enough for an image.

        By default all samples are stored, band by band and pass by pass.
        """
        return stored_rows(job, self.samples)

    def samples(self, job: Job, band: Band, begin: int, end: int) -> list[Float]:
        """The samples begin <= k < end of a band's pixels: per channel an array [k - begin][pixel]."""
        raise RenderError(f"the schedule '{self.name}' has no samples")

    def carries_sums(self, job: Job) -> bool:
        """True if `replay` keeps a pixel's samples in one lane, and carries sums from pass to pass."""
        return False

    def replay(
        self, job: Job, values: Detached, numbering: Numbering, band: Band, begin: int, end: int, mode_of: ModeOf
    ) -> tuple[Mode, list[Float], UInt32]:
        """Walk the samples begin <= k < end of a band's pixels twice, for derivatives.

        See `djpt.rendering.gradients.replay`.

        Returns the mode, the lanes' sums (not evaluated), and a number to evaluate if there are none.
        """
        raise RenderError(f"the schedule '{self.name}' can't replay paths")
