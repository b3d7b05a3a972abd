"""The contract of media."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.core.numeric import non_negative
from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.core.records.flags import PhaseFunctionFlags, has_flag
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.plugin import NotMovable, ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import lookup
from djpt.dispatch.scripted import accept_scripts
from djpt.jit.frozen import recording
from djpt.jit.kernels import as_float, maximum, minimum
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.media import tracking
from djpt.media.flight import Flight, of_channel
from djpt.samplers.base import SampleStream

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["MeasuredMedium", "Medium", "as_scale"]


class Medium(Plugin):
    """Matter between surfaces, which absorbs and scatters light.

    Lengths are in units of the world, coefficients per unit of length. Per length light meets matter sigma_t times,
    and is scattered sigma_s times = albedo sigma_t. Per length, too, a medium that glows adds its `emission` to the
    radiance, whatever its extinction: a thin flame of length d has the radiance emission * d.

    A class defines the coefficients by `get_majorant`, `get_scattering_coefficients` and
    `intersect_aabb`, as in Mitsuba. All methods below "in kernels" run once per class, with per-lane values (see
    `djpt.dispatch.ensemble`).

    Parameters of all media: a nested phase function (any key; default `isotropic`), `sample_emitters` (default true:
    light sampling at points in the medium), `emission` (radiance per unit of length that the medium adds, the same
    in all directions: a number, rgb or volume >= 0; default: none). Paths find it; light sampling ignores
    it.
    """

    kind: ClassVar[str] = "medium"
    is_tracked: ClassVar[bool] = True
    """True if flights are tracked, collision by collision; else they have a closed form."""

    m_sample_emitters: bool = True
    m_is_homogeneous: bool = False
    m_has_spectral_extinction: bool = True
    phase: Any = None
    """The phase function, a plugin of kind `phase`; None if nothing is scattered."""
    emission: Any = None
    """The radiance that the medium adds per unit of length, a volume; None if it doesn't glow."""

    def __init__(self, props: Properties | None = None) -> None:
        super().__init__(props)
        if props is None:
            return
        self.phase = props.child("phase") or lookup("phase", "isotropic")(
            Properties("isotropic", f"{props.node}.phase_function", {}, f"{props.id()}.phase_function")
        )
        self.m_sample_emitters = props.boolean("sample_emitters", True)
        self.emission = props.volume("emission", low=0.0) if "emission" in props else None

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        accept_scripts(cls, Medium, CONVERSIONS)

    def traverse(self, callback: TraversalCallback) -> None:
        if self.emission is not None:
            callback.put("emission", self.emission)
        if self.phase is not None:
            callback.put("phase_function", self.phase)

    # ---- working frames ----------------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        """By default media can't be moved: only the class knows which of its values are per unit of length."""
        raise NotMovable(f"{self.id()}: this medium can't be moved, as its values per unit of length aren't known")

    def move_nested(self, frame: Frame) -> None:
        """Move the phase function and other children, and convert the emission."""
        super().move_nested(frame)
        self.emission = frame.rescaled(self.emission, -1)

    # ---- what is known when kernels are traced ---------------------------------------

    def phase_function(self) -> Any:
        """The phase function."""
        return self.phase

    def use_emitter_sampling(self) -> bool:
        """True if emitters are sampled from points in the medium."""
        return self.m_sample_emitters

    def is_homogeneous(self) -> bool:
        """True if the medium is the same everywhere."""
        return self.m_is_homogeneous

    def has_spectral_extinction(self) -> bool:
        """True if the extinction may differ between the channels."""
        return self.m_has_spectral_extinction

    def emits(self) -> bool:
        """True if the medium glows."""
        return self.emission is not None

    def of_extinction(self) -> Sequence[Plugin]:
        """The plugins whose values the tracked extinction depends on: by default the medium and all its children."""
        children = (getattr(self, name) for name in self.children)
        return [self, *(child for child in children if isinstance(child, Plugin))]

    # ---- in kernels: coefficients ------------------------------------------------------

    def get_majorant(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """A coefficient that sigma_t never exceeds: of `mi` only `wi` is known."""
        raise NotImplementedError

    def get_scattering_coefficients(
        self, mi: MediumInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f, Color3f]:
        """sigma_s, sigma_n = majorant - sigma_t, and sigma_t at a point."""
        raise NotImplementedError

    def intersect_aabb(self, ray: Ray3f) -> tuple[Bool, Float, Float]:
        """The intersection of a ray with the medium's box: True if any, and the distances of entry and exit."""
        raise NotImplementedError

    # ---- in kernels: collisions, as scripts ask for them ---------------------------------

    def sample_interaction(
        self, ray: Ray3f, sample: Float, channel: UInt32, active: Bool | bool = True
    ) -> MediumInteraction3f:
        """Sample a collision, null collisions included, by the majorant of a channel.

        t = t_0 - log(1 - sample) / majorant, where the ray enters the medium's box at t_0; infinite if that lies beyond
        the ray's end.
        """
        mei = MediumInteraction3f.on(ray, Float(dr.inf))
        meets, mint, maxt = self.intersect_aabb(ray)
        active = Bool(active) & meets & (dr.isfinite(mint) | dr.isfinite(maxt))
        mint = dr.select(active, dr.maximum(mint, 0), Float(0))
        maxt = minimum(dr.select(active, maxt, dr.inf), ray.maxt)
        mei.combined_extinction = self.get_majorant(mei, active)
        t = mint - dr.log(1 - sample) * dr.rcp(of_channel(mei.combined_extinction, channel))
        valid = active & (t <= maxt)
        mei.t, mei.p, mei.mint = dr.select(valid, t, dr.inf), ray(t), mint
        mei.sigma_s, mei.sigma_n, mei.sigma_t = self.get_scattering_coefficients(mei, valid)
        return mei

    def transmittance_eval_pdf(
        self, mi: MediumInteraction3f, si: SurfaceInteraction3f, active: Bool | bool = True
    ) -> tuple[Color3f, Color3f]:
        """The transmittance up to a sampled collision or, if it is closer, a surface; and the density of getting there.

        For the majorant, so null collisions included; the density is of the distance, or of having passed it.
        """
        length = minimum(mi.t, si.t) - mi.mint
        passed = dr.exp(-length * mi.combined_extinction)
        return passed, dr.select(si.t < mi.t, passed, passed * mi.combined_extinction)

    # ---- in kernels: flights, as integrators ask for them ----------------------------------

    def reach(
        self, ray: Ray3f, channel: UInt32 | None, throughput: Color3f, stream: SampleStream, active: Bool
    ) -> Float:
        """The distance of `fly`, if it depends on its numbers alone and not on what lies on the way; else infinity.

        Arguments as for `fly`, with a copy of the stream. A class with a closed form of its own for `fly` has one here,
        too, or returns infinity.
        """
        return Float(dr.inf)

    def fly(
        self,
        ray: Ray3f,
        length: Float,
        channel: UInt32 | None,
        throughput: Color3f,
        stream: SampleStream,
        active: Bool,
    ) -> Flight:
        """Sample how far light travels on a segment of a ray with a unit direction; by default by delta tracking.

        Where `active`, numbers are drawn from `stream`. `channel` is the one that samples distances in closed form;
        None if the extinction of no medium differs between channels, or the medium is to draw one. `throughput` is the
        path's so far: how much the channels matter.
        """
        return tracking.fly(self, ray, length, throughput, stream, active)

    def passing_weight(self, ray: Ray3f, t: Float, throughput: Color3f, active: Bool | bool = True) -> Color3f:
        """The transmittance up to the distance `t`, over the probability that `fly` gets that far.

        1 if the extinction doesn't differ between channels. Media that are tracked don't know it if it does.
        """
        return Color3f(1)

    def transmittance(self, ray: Ray3f, length: Float, stream: SampleStream | None, active: Bool) -> Color3f:
        """The fraction of light left after a segment of a ray with a unit direction; by default by ratio tracking.

        Where `active`, an estimate draws numbers from `stream`; a closed form needs none.
        """
        assert stream is not None
        return tracking.transmittance(self, ray, length, stream, active)

    # ---- in kernels: what trackers ask for ---------------------------------------------------

    def majorants(self, ray: Ray3f) -> tracking.Majorants:
        """A function that returns a majorant from a point of a ray onwards, and the distance up to which it holds."""
        color = self.get_majorant(MediumInteraction3f.on(ray, Float(0)))
        largest = maximum(maximum(color.x, color.y), color.z)
        return lambda t, active: (largest, Float(dr.inf))

    def extinction(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """sigma_t at a point, in the form that is differentiated."""
        return self.get_scattering_coefficients(mi, active)[2]

    def extinction_at(self, mi: MediumInteraction3f, u: Float, active: Bool | bool = True) -> Color3f:
        """sigma_t at a point, or an estimate of it from a uniform number."""
        return self.extinction(mi, active)

    def emission_at(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """The radiance that the medium adds per unit of length at a point; asked only if it glows."""
        return self.emission.eval(mi, active)

    def albedo_at(self, mi: MediumInteraction3f, active: Bool | bool = True) -> Color3f:
        """The scattered fraction of the light that meets matter at a point."""
        sigma_s, _, sigma_t = self.get_scattering_coefficients(mi, active)
        return dr.select(sigma_t > 0, sigma_s * dr.rcp(sigma_t), 0)


def as_span(found: Sequence[Any]) -> tuple[Bool, Float, Float]:
    """Convert what a script's `intersect_aabb` returns."""
    meets, mint, maxt = found
    return Bool(meets), Float(mint), Float(maxt)


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "get_majorant": Color3f,
    "get_scattering_coefficients": lambda found: tuple(Color3f(color) for color in found),
    "intersect_aabb": as_span,
}


class MeasuredMedium(Medium):
    """A medium whose coefficients are volumes, `sigma_t` and `albedo`, and a factor of the first, `scale`."""

    children = ("albedo", "sigma_t", "emission", "phase")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        sigma_t, albedo = self.defaults(props)
        self.albedo = props.volume("albedo", albedo, low=0.0, high=1.0)
        self.sigma_t = props.volume("sigma_t", sigma_t, low=0.0)
        self.scale = as_float(props.float("scale", 1.0, low=0.0))
        self.m_has_spectral_extinction = props.boolean("has_spectral_extinction", True)

    def defaults(self, props: Properties) -> tuple[Any, Any]:
        """The `sigma_t` and the `albedo` of a description that doesn't give them."""
        return 1.0, 0.75

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("scale", self.scale, ParamFlags.Differentiable)
        callback.put("albedo", self.albedo)
        callback.put("sigma_t", self.sigma_t)
        super().traverse(callback)

    def check_parameter(self, name: str, value: Any) -> Any:
        return as_scale(value) if name == "scale" else value

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.scale = as_scale(self.scale / frame.scale)

    def has_spectral_extinction(self) -> bool:
        return self.m_has_spectral_extinction and not self.sigma_t.is_grey

    def is_of_flakes(self) -> bool:
        """True if the extinction depends on the direction."""
        return bool(has_flag(self.phase.flags(), PhaseFunctionFlags.Microflake))

    def effective(self, density: Color3f, mi: MediumInteraction3f, active: Bool | bool) -> Color3f:
        """The extinction of light arriving from `mi.wi`, by the value of `sigma_t`."""
        sigma_t = density * self.scale
        if self.is_of_flakes():
            sigma_t = sigma_t * self.phase.projected_area(mi, active)
        return sigma_t


def as_scale(value: Any) -> Float:
    """Convert an edited `scale`; gradients are kept.

    Raises:
        SceneError: Not one finite number that is at least 0.
    """
    if recording():
        return Float(value)
    attached = dr.is_array_v(value) and dr.grad_enabled(value)
    number = non_negative(dr.detach(value) if attached else value)
    return Float(value) if attached else dr.opaque(Float, number)
