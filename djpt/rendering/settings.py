"""The settings of a render: what the verbs of rendering are told, checked once and then handed on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr

from djpt.core.interruption import Interruption
from djpt.core.numeric import whole
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.integrators.base import Integrator
from djpt.integrators.path import Path
from djpt.jit.frozen import recording
from djpt.jit.types import UInt32
from djpt.rendering.progress import Progress
from djpt.rendering.schedules.job import MAX_SAMPLES
from djpt.samplers.seeds import Seed, gradient_seed
from djpt.scene.scene import Scene, find_sensor, require_scene
from djpt.sensors.base import Sensor

__all__ = ["RenderSettings", "check_count", "check_seed", "find_integrator"]


@dataclass(frozen=True)
class RenderSettings:
    """How a scene is rendered. `of` makes the settings from the arguments of a verb such as `djpt.render`.

    Variations are made by `dataclasses.replace`, which checks nothing.
    """

    sensor: Sensor
    """What the image is taken by; its film says how large the image is, and its sampler draws the random numbers."""
    integrator: Integrator
    """The estimator of the light along camera rays."""
    seed: Seed = 0
    """The seed of the image, 0 <= seed < 2^32; an array of one number where `dr.freeze` records."""
    spp: int = 0
    """Samples per pixel as they were asked for; 0: the sampler's `sample_count`. See `sample_count`."""
    schedule: str = "auto"
    """How lanes are filled: `flat`, `machine`, `wave`, or `auto`, the fastest. `djpt.rendering.schedules.choice` checks
    it, since what is possible depends on the scene."""
    pass_spp: int = 0
    """Samples per pixel of one pass; 0: as many as suit the schedule. It changes time and memory, never the image."""
    seed_grad: Seed | None = 0
    """The seed of the gradient's samples; 0: one derived from `seed`; None: `seed`, which correlates the two."""
    spp_grad: int = 0
    """Samples per pixel for the gradient; 0: as many as for the image."""
    progress: Progress | None = None
    """Called with (samples done, samples in all) after each pass."""
    interruption: Interruption | None = None
    """The signals that end the render after a pass; None: whatever Python makes of them."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        sensor: Any = 0,
        integrator: Any = None,
        *,
        seed: Any = 0,
        spp: Any = 0,
        schedule: str = "auto",
        pass_spp: Any = 0,
        seed_grad: Any = 0,
        spp_grad: Any = 0,
    ) -> RenderSettings:
        """Check the arguments of a verb for a scene, which become the attributes of the same names.

        `sensor` is an index into ``scene.sensors()``, or a sensor; the default `integrator` is the scene's, or `path`.

        Raises:
            RenderError: An argument is of a wrong type or out of range.
        """
        return cls(
            integrator=find_integrator(scene, integrator),
            sensor=find_sensor(scene, sensor),
            seed=check_seed("seed", seed),
            spp=check_count("spp", spp),
            schedule=schedule,
            pass_spp=check_count("pass_spp", pass_spp),
            seed_grad=None if seed_grad is None else check_seed("seed_grad", seed_grad),
            spp_grad=check_count("spp_grad", spp_grad),
        )

    @property
    def gradient_seed(self) -> Seed:
        """The seed of the gradient's samples: see `djpt.samplers.seeds.gradient_seed`."""
        return self.seed if self.seed_grad is None else gradient_seed(self.seed, self.seed_grad)

    @property
    def is_watched(self) -> bool:
        """Whether somebody waits for the ends of passes."""
        return self.progress is not None or self.interruption is not None

    @property
    def sample_count(self) -> int:
        """Samples per pixel that are taken: `spp`, or the sampler's default, as the sampler rounds it up."""
        sampler = self.sensor.sampler()
        return int(sampler.round_count(self.spp or sampler.sample_count()))


def find_integrator(scene: Scene, integrator: Any) -> Integrator:
    """The integrator that was asked for, or the scene's, or else `path`."""
    require_scene(scene)
    if integrator is None:
        integrator = scene.integrator() or Path(Properties("path", "integrator", {}))
    if not isinstance(integrator, Integrator):
        hint = "; load it with djpt.load_dict first" if isinstance(integrator, dict) else ""
        raise RenderError(f"'integrator' must be an integrator plugin, found {type(integrator).__name__}{hint}")
    return integrator


def check_count(name: str, value: Any) -> int:
    """The value as an int; raises `RenderError` unless it is whole, not negative and fits into 32 bits."""
    count = whole(value)
    if count is None or count < 0:
        raise RenderError(f"'{name}' must be a whole number, 1 or more (0 = default), found {value!r}")
    if count >= MAX_SAMPLES:
        raise RenderError(f"'{name}' must be below 2^32, found {value!r}")
    return count


def check_seed(name: str, value: Any) -> Seed:
    """The value as an int; raises `RenderError` unless it is whole and fits into 32 bits.

    An array stays one where `dr.freeze` records: the next call of the frozen function may bring another value.
    """
    if recording() and dr.is_jit_v(value) and dr.is_integral_v(value) and dr.depth_v(value) == 1:
        if dr.width(value) != 1:
            raise RenderError(f"'{name}' must be one whole number, found {dr.width(value)}")
        return UInt32(value)
    seed = whole(value)
    if seed is None or not 0 <= seed < 2**32:
        raise RenderError(f"'{name}' must be a whole number with 0 <= {name} < 2^32, found {value!r}")
    return seed
