"""The contract of integrators that start at the lights, or that work in passes with state between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float, Point2f, UInt32
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.films import Film
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["LightPath", "PassIntegrator", "Walks"]


@dataclass
class LightPath:
    """The state of a light path between two vertices.

    An estimator that carries more (densities, say) derives a dataclass from it.
    """

    ray: Ray3f
    flux: Color3f
    """Emitted radiance times cosine over the density, times the product of f abs(cos) / p and of what media left."""
    unit: Float
    """1 / the largest component of the flux at the emitter: Russian roulette depends on the flux times this."""
    eta: Float | None
    """Product of relative indices of refraction; None in scenes without refraction."""
    depth: UInt32
    """The number of edges so far."""
    zero_weight: Color3f | None = None
    """While derivatives are replayed, the factor of each channel of the flux that was set aside, or 1; else None."""


class Walks(Protocol):
    """The interface of passes: the image to be made, and walks through the scene."""

    @property
    def scene(self) -> Scene:
        """The scene."""

    @property
    def camera(self) -> Sensor:
        """The sensor, with opaque values."""

    @property
    def film(self) -> Film:
        """The film."""

    @property
    def spp(self) -> int:
        """Paths per pixel of the whole image."""

    @property
    def seed(self) -> UInt32:
        """The seed, an opaque number of width 1."""

    def ray_at(self, place: Point2f, stream: SampleStream) -> Ray3f:
        """A camera ray through a place in [0, 1)^2 on the crop window, by the next numbers of a stream."""

    def light(
        self,
        start: Callable[[SampleStream], LightPath],
        vertex: Callable[[SampleStream, LightPath, SurfaceInteraction3f], tuple[LightPath, Bool]],
        sinks: Any,
        begin: int,
        end: int,
    ) -> None:
        """Follow `begin` <= k < `end` light paths for each pixel of the crop window.

        `start` gives a path that leaves a light; `vertex` processes a hit (or miss) of its ray, adds what there is to
        add to the `sinks`, and returns the path that goes on and whether it does. The flux that arrives at a vertex
        includes absorption by media. Kernels write to `sinks` (any PyTree of Dr.Jit arrays), which are evaluated.
        """


class PassIntegrator(Integrator):
    """An estimator that makes an image in passes.

    A pass advances the whole image by some paths per pixel. The state that passes hand on is the estimator's own:
    sums of splats, photons and radii, the points of Markov chains. Light that is easier to find from the camera's
    side is left to the integrator `from_camera`, whose image is added.
    """

    schedules = ("progressive",)
    needs_light = True
    follows_motion = False
    differentiable = False

    from_camera: Integrator | None = None
    """The integrator for light that the passes leave out; None if they leave out nothing."""

    def begin(self, walks: Walks) -> Any:
        """The state before the first pass."""
        raise NotImplementedError

    def add_pass(self, walks: Walks, state: Any, begin: int, end: int) -> Any:
        """The state after the paths `begin` <= k < `end` of every pixel."""
        raise NotImplementedError

    def color(self, walks: Walks, state: Any) -> Color3f:
        """The image that a state represents, one entry per pixel of the crop window, row by row."""
        raise NotImplementedError
