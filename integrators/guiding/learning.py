"""The contract of integrators that learn about the scene before they render it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from djpt.core.records import Ray3f
from djpt.integrators.base import Integrator
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["LearningIntegrator", "TrainingPaths"]


class TrainingPaths(Protocol):
    """Paths that an integrator learns from, and that no image counts."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    @property
    def samples(self) -> int:
        """The number of samples of the image that is to be rendered."""

    def begin(self, first: int, end: int) -> tuple[SampleStream, Ray3f]:
        """Random numbers and camera rays of the paths `first` <= i < `end`, which are spread evenly over the image."""

    def pause(self) -> None:
        """Stop here if somebody has asked for it."""


class LearningIntegrator(Integrator):
    """An estimator that follows paths to learn from them, and renders with what it knows then.

    What it has learned doesn't depend on the samples of the image, whose mean it can't change therefore.
    """

    schedules: tuple[str, ...] = ("learning",)
    needs_light = True
    differentiable = False

    def trained(self, training_paths: TrainingPaths) -> Integrator:
        """The integrator that knows the scene, and renders the image."""
        raise NotImplementedError
