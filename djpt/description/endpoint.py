"""The base of emitters and sensors, the ends of light paths."""

from __future__ import annotations

from typing import Any

from djpt.description.plugin import Plugin
from djpt.description.properties import Properties
from djpt.errors import RenderError

__all__ = ["Endpoint"]


class Endpoint(Plugin):
    """An end of light paths: rays leave it, and directions towards it can be sampled.

    The questions are Mitsuba's; an endpoint that has no answer to one raises `djpt.RenderError`. What is sampled is
    radiance for emitters and importance, of which light that arrives counts so much, for sensors.
    """

    shape: Any = None
    """The shape that it stands in; set by the scene."""
    _medium: Any = None
    m_needs_sample_2: bool = True
    """The result of `needs_sample_2`; scripts written for Mitsuba set it."""
    m_needs_sample_3: bool = True
    """The result of `needs_sample_3`; scripts written for Mitsuba set it."""

    def __init__(self, props: Properties | Plugin | None = None) -> None:
        super().__init__(props)

    # ---- where it is --------------------------------------------------------------------------

    def get_shape(self) -> Any:
        """The shape that it stands in, or None."""
        return self.shape

    def set_shape(self, shape: Any) -> None:
        """Put it into a shape."""
        self.shape = shape

    def get_medium(self) -> Any:
        """The medium that it was put into, or None; `djpt.scene.media_placement.Media` finds that of a sensor."""
        return self._medium

    def set_medium(self, medium: Any) -> None:
        """Put it into a medium; only sensors are asked for theirs."""
        self._medium = medium

    def set_scene(self, scene: Any) -> None:
        """Take the size of a scene that it isn't part of: what is far away depends on it."""
        self.set_bounds(*scene.bounding_sphere())

    def set_bounds(self, center: Any, radius: float) -> None:
        """Take the bounding sphere of a scene."""

    def world_transform(self) -> Any:
        """The transform from its own space to the world's; that of the shape if it stands in one."""
        return getattr(self if self.shape is None else self.shape, "to_world", None)

    def bbox(self) -> Any:
        """The box about it, world space."""
        raise self.unanswered("no bounding box")

    # ---- samples --------------------------------------------------------------------------------

    def needs_sample_2(self) -> bool:
        """True if `sample_ray` may look at its second sample."""
        return self.m_needs_sample_2

    def needs_sample_3(self) -> bool:
        """True if `sample_ray` may look at its third sample."""
        return self.m_needs_sample_3

    def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
        """A ray that leaves it, and its weight."""
        raise self.unanswered("no rays")

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        """A direction from the point `it` towards it, and what arrives along it over the density."""
        raise self.unanswered("no directions to sample")

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """The density of `sample_direction` at `ds`, per unit solid angle."""
        raise self.unanswered("no density of directions")

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """The light that arrives along a direction of `sample_direction`."""
        raise self.unanswered("nothing that arrives from a given direction")

    def sample_position(self, ref: Any, ds: Any, active: Any = True) -> Any:
        """A point of it at the time `ref`, from the sample `ds`, and 1 / density."""
        raise self.unanswered("no surface to sample")

    def pdf_position(self, ps: Any, active: Any = True) -> Any:
        """The density of `sample_position`, per unit area."""
        raise self.unanswered("no density of positions")

    def eval(self, si: Any, active: Any = True) -> Any:
        """The light that leaves its surface at `si` towards `si.wi`."""
        raise self.unanswered("no surface to look at")

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
        """Sample wavelengths: none, and the value of `eval`."""
        raise self.unanswered("no surface to look at")

    def unanswered(self, what: str) -> RenderError:
        """The error of a question that it has no answer to."""
        return RenderError(f"{self.id()}: the {self.kind} '{type(self).__name__}' has {what}")
