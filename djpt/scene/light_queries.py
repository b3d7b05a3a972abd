"""How a scene chooses among its emitters, and what scripts ask about them, with Mitsuba's arguments."""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import numpy as np

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.records import DirectionSample3f, Observer, Ray3f, SurfaceInteraction3f
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.emitters.base import Emitter
from djpt.emitters.light_samplers import make_choice
from djpt.emitters.light_samplers.base import EmitterChoice
from djpt.emitters.light_samplers.sampling import LightSampling
from djpt.emitters.pointer import EmitterPtr, observer
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32

__all__ = ["LightQuestions"]


class LightQuestions:
    """The part of a scene that chooses an emitter and asks it."""

    lights: Ensemble[Emitter]
    lookup: Lookup
    _choice_name: str
    _choices: dict[str, EmitterChoice]
    """The ways to choose that were asked for, by name; views share them."""
    _brightness: list[float]
    """The estimate of `brightness`, once it was asked for."""

    def begin_choices(self) -> None:
        """Choose uniformly, as long as no view says otherwise."""
        self._choice_name, self._choices, self._brightness = "uniform", {}, []

    def forget_choices(self) -> None:
        """Follow an edit that may change how bright the emitters are."""
        self._choices.clear()
        self._brightness.clear()

    def choosing_emitters(self, choice: str) -> Any:
        """A view of this scene whose emitters are chosen in another way: see `djpt.emitters.light_samplers`."""
        if choice == self._choice_name:
            return self
        view = self._view()
        view._choice_name = choice
        return view

    @property
    def light_sampling(self) -> LightSampling:
        """The emitters, the way to choose among them, and the way to read their values."""
        return LightSampling(self.lights, self.emitter_choice, self.lookup)

    @property
    def emitter_choice(self) -> EmitterChoice:
        """The way to choose an emitter: see `choosing_emitters`."""
        name = self._choice_name
        if name not in self._choices:
            self._choices[name] = make_choice(name, self.emitters())
        return self._choices[name]

    # ---- what the scene answers ----------------------------------------------------------

    def _view(self) -> Any:
        """A shallow copy of the scene."""
        raise NotImplementedError

    def emitters(self) -> list[Emitter]:
        """All emitters."""
        raise NotImplementedError

    def bbox(self) -> ScalarBoundingBox3f:
        """The box about all shapes."""
        raise NotImplementedError

    def light_through(self, ray: Ray3f, light: Color3f | None = None) -> Color3f:
        """The part of `light` that arrives along the segment of a `shadow_ray`."""
        raise NotImplementedError

    def shadow_ray(self, si: SurfaceInteraction3f, ds: DirectionSample3f) -> Ray3f:
        """The ray from `si` to the emitter sample `ds`."""
        raise NotImplementedError

    def emitter_ptr(self, index: UInt32) -> EmitterPtr:
        """The emitters with the numbers `index`, per lane."""
        raise NotImplementedError

    # ---- questions -----------------------------------------------------------------------

    @property
    def brightness(self) -> float:
        """A rough estimate of the radiance in the scene, as a power of two.

        It is that of the power of all emitters, spread over a sphere about the scene.
        """
        if not self._brightness:
            low, high = (np.array(corner).ravel() for corner in self.bbox())
            radius = max(float(np.linalg.norm(high - low)) / 2, 1e-6)
            radiance = sum(e.power() for e in self.emitters()) / (math.pi * 4 * math.pi * radius**2)
            self._brightness.append(2.0 ** round(math.log2(radiance)) if radiance > 0 else 1.0)
        return self._brightness[0]

    def sample_emitter(self, sample: Any, active: Bool | bool = True) -> tuple[UInt32, Float, Float]:
        """Choose an emitter by a uniform number: its number, 1 / probability, and a fresh uniform number."""
        index, inverse, left = self.emitter_choice.choose(Point3f(0), None, Float(sample))
        return index, inverse, left

    def pdf_emitter(self, index: Any, active: Bool | bool = True) -> Float:
        """The probability that `sample_emitter` gives the emitter with the number `index`."""
        return self.emitter_choice.probability(Point3f(0), None, UInt32(index))

    def sample_emitter_direction(
        self, ref: Observer, sample: Point2f, test_visibility: bool = True, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """Choose an emitter, sample a direction towards it; weight = radiance / pdf.

        `ds.pdf` includes the probability of choosing the emitter. `sample.x` chooses and is then stretched
        for use in the emitter. With `test_visibility` the weight is 0 behind surfaces, and includes absorption.
        """
        light = self.light_sampling.sample(ref, Point2f(sample), active)
        ds, weight = light.ds, light.weight
        if test_visibility:
            weight = self.light_through(self.shadow_ray(ref, ds), weight)  # type: ignore[arg-type]
        ds.home = {self: ()}
        return ds, weight

    def pdf_emitter_direction(
        self, ref: Observer | Point3f, ds: DirectionSample3f, active: Bool | bool = True
    ) -> Float:
        """The density of `sample_emitter_direction` at `ds`, per unit solid angle at `ref`.

        Of a mere point the normal isn't known: an `emitter_choice` that looks at it needs more.
        """
        return self.light_sampling.pdf(observer(ref), ds, active)

    def eval_emitter_direction(self, ref: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """What arrives from the emitter of `ds` in its direction, whatever stands between.

        That is the radiance; of a point, intensity / dist^2; of parallel light, the irradiance.
        """
        return self.emitter_ptr(ds.emitter_index).eval_direction(ref, ds, active)

    def sample_emitter_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f, EmitterPtr]:
        """Choose an emitter by `sample1` and sample a ray that leaves it; the weight includes the choice."""
        index, inverse, left = self.sample_emitter(sample1, active)
        emitter = self.emitter_ptr(index)
        ray, weight = emitter.sample_ray(time, left, sample2, sample3, active)
        return ray, weight * dr.select(active, inverse, 0), emitter
