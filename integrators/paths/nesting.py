"""The base of integrators that render others along with channels of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.records import Ray3f
from djpt.description.plugin import TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import SceneError
from djpt.integrators.base import Integrator
from djpt.integrators.guiding.training import LearningIntegrator
from djpt.jit.types import Bool, Color3f, Float
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["NestingIntegrator"]


class NestingIntegrator(Integrator):
    """An integrator with others nested in it, under any keys; each keeps its parameters, `emitter_choice` included.

    The colour of the image is that of the first.
    """

    runs_as_nested = False
    """True if the schedules of the only nested integrator run this one, too: see `run_as_nested`."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.nested: list[tuple[str, Integrator]] = props.children("integrator")
        integrators = [integrator for _, integrator in self.nested]
        for name, integrator in self.nested:
            if integrator.starts_at_lights:
                raise SceneError(f"{props.node}.{name}: an integrator that traces rays from lights can't be nested")
            if isinstance(integrator, LearningIntegrator):
                raise SceneError(f"{props.node}.{name}: an integrator that learns about the scene can't be nested")
        self.follows_overlaps = all(integrator.follows_overlaps for integrator in integrators)
        self.needs_light = any(integrator.needs_light for integrator in integrators)
        # Paths are replayed for integrators that stand alone, or that run others: their `sample` has no derivative.
        self.differentiable = all(
            integrator.differentiable and not (integrator.stepwise or integrator.renders_itself())
            for integrator in integrators
        )

    def run_as_nested(self) -> None:
        """Take over the schedules of the only nested integrator, if it advances vertex by vertex.

        For classes whose channels follow from its finished samples, and from camera rays: those that define
        `sample_channels` or `camera_channels`. At the end of `__init__`.
        """
        ((_, nested), *others) = self.nested
        self.runs_as_nested = not others and nested.stepwise and not nested.aov_names()
        if self.runs_as_nested:
            self.schedules, self.emitter_choice = nested.schedules, nested.emitter_choice
            self.follows_media = nested.follows_media
            self.measures_distance = self.measures_distance or nested.measures_distance

    @property
    def path_tracer(self) -> Integrator:
        return self.nested[0][1] if self.runs_as_nested else self

    @property
    def stepwise(self) -> bool:
        # Its paths aren't replayed for derivatives.
        return False

    def traverse(self, callback: TraversalCallback) -> None:
        for i, (_, integrator) in enumerate(self.nested):
            callback.put(f"integrator_{i}", integrator)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        # It leaves out nothing itself, only the nested integrators do.
        for _, integrator in self.nested:
            integrator.check_scene(scene, sensor)

    def fits_any_frame(self) -> bool:
        return super().fits_any_frame() and all(integrator.fits_any_frame() for _, integrator in self.nested)

    def is_pure(self) -> bool:
        nested = [integrator for _, integrator in self.nested]
        return super().is_pure() and all(one.is_pure() and not one.renders_itself() for one in nested)

    def samples(
        self, scene: Scene, sampler: SampleStream, ray: Ray3f, active: Bool | bool = True
    ) -> list[tuple[Color3f, Bool, list[Float]]]:
        """One sample of each nested integrator, from the random numbers that it would draw alone."""
        samples = (
            integrator.sample_nested(
                scene.replace(emitter_choice=integrator.emitter_choice), sampler.clone(), ray, active
            )
            for _, integrator in self.nested
        )
        # Those that aren't pure may return Python's numbers.
        return [(Color3f(color), Bool(valid), [Float(value) for value in aovs]) for color, valid, aovs in samples]
