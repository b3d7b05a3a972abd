"""The contract of integrators that gather photons: progressive photon mapping."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import drjit as dr

from djpt.core.records import BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.core.records.flags import PhaseFunctionFlags
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.properties import Properties
from djpt.errors import RenderError
from djpt.integrators.bidirectional.strategies import SplattingIntegrator
from djpt.integrators.photons import Photon, PhotonMap, PhotonStore
from djpt.integrators.photons.photon import MOST_MEDIA, bytes_of, require_memory
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Color3f, Float, Point3f, UInt32, Vector3f
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.scene.scene import Scene
    from djpt.sensors.base import Sensor

__all__ = ["PhotonMapping", "is_sharp", "over_cosine", "over_scattering", "scattering_at", "scatters"]

MOST_PATHS = 2**26
"""The maximum number of light paths of a pass."""

Self = TypeVar("Self", bound="PhotonMapping")


class PhotonMapping(SplattingIntegrator):
    """An estimator whose camera paths gather photons: the records that light paths have left near a surface point.

    An image is made in passes. Each traces `photon_count` light paths, whose photons make a map, and one sample of each
    pixel, or as many as give one camera path for `paths_per_sample` light paths,
    which gather from it. Counting all photons within a radius as if they had arrived at the point itself blurs the
    image, which is an error; it vanishes, because the radius shrinks from pass to pass::

        r_i = r_1 i^((alpha - 1) / 2),    i = 1, 2, ..

    Slowly enough, for 0 < alpha < 1, for the noise to vanish as well. A pass depends on the film's size and
    these parameters alone, so an image is a function of (scene, spp, seed).

    Parameters, besides those of the estimator: `photon_count` (light paths of a pass, default 2^18),
    `initial_radius` (in the scene's units, > 0; default 0: from what the sensor sees, see below), `alpha` (in (0, 1],
    default 2/3; 1 keeps the radius).

    The first radius is such that the points that some camera rays see have `crowd` photons around them on average, but
    at most 1/72 of the width of what the picture shows there (`djpt.rendering.schedules.photons`). It doesn't
    depend on the seed or on the samples per pixel.

    T. Hachisuka and H. W. Jensen, "Stochastic Progressive Photon Mapping", 2009; C. Knaus and M. Zwicker, "Progressive
    Photon Mapping: A Probabilistic Approach", 2011; A. Kaplanyan and C. Dachsbacher, "Adaptive Progressive Photon
    Mapping", 2013, find that the error falls fastest for 2/3.
    """

    schedules: tuple[str, ...] = ("photons",)
    starts_at_lights = True
    holds_sums: ClassVar[bool] = True

    default_photon_count: ClassVar[int] = 2**18
    """The light paths of a pass, unless a description says something else; a power of two, as films and samples often
    are: a last pass of a few samples would take as many light paths as the others.
    """

    paths_per_sample: ClassVar[float] = 4
    """The light paths of a pass for each of its camera paths, at most."""

    crowd: ClassVar[float] = 32.0
    """The photons within the first radius about a point that the camera sees, on average, unless it is given."""

    weighs_photons: ClassVar[bool] = False
    """True if photons keep the weights of their light paths."""

    photons: PhotonMap | None = None
    """The map of the current pass."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.differentiable = False
        self.photon_count = props.integer("photon_count", self.default_photon_count, low=1, high=MOST_PATHS)
        self.initial_radius = props.float("initial_radius", 0.0, low=0.0)
        self.alpha = props.float("alpha", 2 / 3, low=0.0, high=1.0, low_open=True)

    def check_scene(self, scene: Scene, sensor: Sensor) -> None:
        if recording():
            raise RenderError(
                f"{self.id()}: dr.freeze can't record photon maps, whose sizes vary by pass; render without it"
            )
        require_memory(self.id(), self.photon_count, self.weighs_photons)
        check_media(self.id(), scene)
        super().check_scene(scene, sensor)

    def prepare_scene(self, scene: Scene) -> None:
        super().prepare_scene(scene)
        scene.lights.brightness  # noqa: B018

    def held_bytes(self) -> int:
        return bytes_of(self.photon_count, self.weighs_photons)

    # ---- passes ------------------------------------------------------------------------

    def radius(self, first: float, number: int) -> float:
        """The radius of the pass `number` = 0, 1, .. of an image, from its `first` radius."""
        return first * (number + 1) ** ((self.alpha - 1) / 2)

    def paths_for(self, sharp_fraction: Callable[[], float]) -> float:
        """The light paths of a pass for each of its camera paths, at most.

        `sharp_fraction` finds out what fraction of camera rays sees by way of mirrors, glass or gloss.
        """
        return self.paths_per_sample

    def paths_of_pass(self, fraction: float) -> int:
        """The light paths of a pass, if the image has this `fraction` of the samples of a whole one."""
        return self.photon_count

    def store(self, scene: Scene) -> PhotonStore:
        """Memory for the photons of a pass."""
        return PhotonStore(self.id(), self.photon_count, self.weighs_photons, scene.media.scatter)

    def looks_in_box(self, scene: Scene) -> bool:
        """True if maps need the box about most of the photons in media, `PhotonMap.box`."""
        return False

    def looking_at(self: Self, photons: PhotonMap) -> Self:
        """A copy of this integrator for the pass of a map, which may be empty yet."""
        integrator = copy.copy(self)
        integrator.photons = photons
        return integrator

    def take(self, store: PhotonStore, count: int) -> None:
        """Take over the `count` photons of a store into the map of the current pass."""
        assert self.photons is not None
        self.photons.fill(store, count)

    def leave(self, scene: Scene, sampler: SampleStream) -> Any:
        """The state of a light path that leaves an emitter: any PyTree."""
        raise NotImplementedError

    def arrive(self, scene: Scene, sampler: SampleStream, path: Any, store: PhotonStore) -> tuple[Any, Bool]:
        """Trace the next edge of a light path, and leave a photon; the continued path, and True where it continues."""
        raise NotImplementedError


def check_media(name: str, scene: Scene) -> None:
    """Raise `RenderError` if a scene has media in which photons can't be gathered."""
    media = scene.every_medium.plugins
    if len(media) > MOST_MEDIA:
        raise RenderError(f"'{name}' can tell {MOST_MEDIA} media apart, found {len(media)}; possible: 'volpath'")
    for medium in media:
        if medium.phase is not None and has_flag(medium.phase.flags(), PhaseFunctionFlags.Microflake):
            raise RenderError(
                f"'{name}' gathers photons in media whose extinction is the same in all directions, found "
                f"'{medium.id()}' with the phase function '{medium.phase.id()}'; possible: 'volpath'"
            )


def scattering_at(scene: Scene, medium: UInt32, p: Point3f, active: Bool) -> tuple[Color3f, Color3f]:
    """sigma_s and sigma_t at points in media, which are the same for all directions."""
    mei = MediumInteraction3f.on(Ray3f(p, Vector3f(0, 0, 1)), Float(0), p)
    return scene.media.coefficients(medium, mei, active)


def over_scattering(found: Color3f, sigma_s: Color3f) -> Color3f:
    """The light scattered at a point per unit of length, over sigma_s, which a sampled vertex has already."""
    result: Color3f = dr.select(sigma_s > 0, found * dr.rcp(sigma_s), 0)
    return result


def scatters(si: SurfaceInteraction3f) -> Bool:
    """True where the BSDF at a surface point has lobes that aren't delta functions: photons are of use there."""
    found: Bool = has_flag(si.bsdf().flags(), BSDFFlags.Smooth)
    return found


SHARP = BSDFFlags.DeltaReflection | BSDFFlags.DeltaTransmission | BSDFFlags.Glossy
"""The lobes of sharp surfaces."""


def is_sharp(si: SurfaceInteraction3f) -> Bool:
    """True on surfaces with mirrors, glass, or gloss."""
    return si.is_valid() & has_flag(si.bsdf().flags(), SHARP)


def over_cosine(value: Color3f, si: SurfaceInteraction3f, photon: Photon) -> Color3f:
    """A BSDF's `value` f abs(cos) towards where a photon came from, over the cosine that its density has already.

    That is the cosine to the geometric normal, since photons are counted per area of the surface.
    """
    cos = dr.abs(dr.dot(si.n, photon.d))
    result: Color3f = dr.select(cos > 0, value * dr.rcp(cos), 0)
    return result
