"""The contract of BSDFs, with bases for some kinds, and the adjoint: light that travels from lights."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, BSDFFlags, BSDFSample3f, SurfaceInteraction3f, TransportMode, has_flag
from djpt.description.plugin import Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.dispatch.scripted import accept_scripts
from djpt.errors import RenderError, SceneError, near_miss
from djpt.jit.types import Bool, Color3f, Float, Point2f, Vector3f

__all__ = [
    "BSDF",
    "BSDFAtPoint",
    "DeltaBSDF",
    "NestingBSDF",
    "SharedWorkBSDF",
    "derivative_of_choice",
    "eval_pdf_light",
    "nested_bsdfs",
    "sample_light",
]


class BSDF(Plugin):
    """The scattering of light at a surface: f(wi, wo) and a way to sample it.

    All methods run in kernels, once per class, with per-lane values (see `djpt.dispatch.ensemble`).

    * `si.wi` and `wo` point away from the surface, in the shading frame (normal +z).
    * `eval` gives f(wi, wo) abs(cos theta_o): the cosine is included. Zero means black.
    * Densities are per unit solid angle of `wo`; delta lobes are never seen by `eval` and `pdf`.
    * `sample` gives a direction and the weight f abs(cos) / pdf; the weight is 0 where nothing
      was sampled.
    * Where `active` is false the results mean nothing: callers mask.

    Sampling decisions are detached. Derivatives of smooth lobes are taken from `eval`, at the sampled
    direction: `wo`, `pdf` and the weight that `sample` returns are used as if they were constants. The
    weight of a delta lobe, which `eval` can't see, keeps its derivative: it must be the lobe's value over
    `dr.detach` of the probability of choosing it.
    """

    kind: ClassVar[str] = "bsdf"
    absorbs: bool = False
    """True if light is attenuated within the body that the surface encloses: see `transmittance`."""

    invisible: ClassVar[bool] = False
    """True if all light passes straight through. Counts for the class that says so, not for those derived from it."""

    bounds_bodies: ClassVar[bool] = False
    """True if it may be the boundary of a body that others overlap: see `surrounded_by`."""

    symmetric: ClassVar[bool] = False
    """True if f(wi, wo) = f(wo, wi), indices of refraction aside: see `is_symmetric`. Counts for the class that says
    so, not for those derived from it."""

    m_flags: int = int(BSDFFlags.Empty)
    """Flags beside those of the lobes; scripts written for Mitsuba set them all."""
    m_components: Sequence[int] = ()
    """The result of `components` unless it is overridden; scripts written for Mitsuba set it."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        accept_scripts(cls, BSDF, CONVERSIONS)

    @property
    def is_symmetric(self) -> bool:
        """True if light can be followed from lights by `sample`: the BSDF and those nested in it are symmetric.

        Those whose classes don't say so are taken not to be: see `djpt.materials.base`.
        """
        nested = (getattr(self, name, None) for name in self.children)
        return self.says("symmetric") and all(plugin.is_symmetric for plugin in nested if isinstance(plugin, BSDF))

    @property
    def needs_interior(self) -> bool:
        """True if light that enters a shape is to be scattered in its interior, by this BSDF or one nested in it."""
        nested = (getattr(self, name, None) for name in self.children)
        return any(plugin.needs_interior for plugin in nested if isinstance(plugin, BSDF))

    def surrounded_by(self, index: Float) -> BSDF:
        """The BSDF of this surface in a medium other than that of its description.

        Args:
            index: The index of refraction of that medium over the one of the description, per lane.
        """
        return self

    def components(self) -> tuple[int, ...]:
        """The `BSDFFlags` of each lobe, numbered as in `BSDFSample3f.sampled_component`."""
        return tuple(int(flags) for flags in self.m_components)

    def component_count(self, active: Bool | bool = True) -> int:
        """The number of lobes."""
        return len(self.components())

    def flags(self, index: int | None = None, active: Bool | bool = True) -> int:
        """The `BSDFFlags` of all lobes together, or of lobe number `index`."""
        lobes = self.components()
        if index is not None:
            return lobes[index]
        return functools.reduce(operator.or_, lobes, int(self.m_flags))

    def asked(self, ctx: BSDFContext) -> tuple[bool, ...]:
        """For each lobe, True if a context asks for it."""
        lobes = self.components()
        if ctx.asks_for_all:
            return (True,) * len(lobes)
        return tuple(ctx.is_enabled(flags & int(BSDFFlags.All), i) for i, flags in enumerate(lobes))

    def is_asked(self, ctx: BSDFContext) -> bool:
        """True if a context asks for any lobe."""
        return ctx.asks_for_all or any(self.asked(ctx))

    def has_attribute(self, name: str, active: Bool | bool = True) -> bool:
        """True if there is a texture or a number of that name among the parameters."""
        return self._attribute(name) is not None

    def eval_attribute(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The parameter of that name at `si`: a texture's colour, or a number.

        Raises:
            RenderError: There is none.
        """
        found = self._known_attribute(name)
        return found.eval(si, active) if isinstance(found, Plugin) else Color3f(found)  # type: ignore[attr-defined]

    def eval_attribute_1(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Float:
        """The parameter of that name at `si` as a number; raises as `eval_attribute` does."""
        found = self._known_attribute(name)
        return found.eval_1(si, active) if isinstance(found, Plugin) else Float(found)  # type: ignore[attr-defined]

    def eval_attribute_3(self, name: str, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The value of `eval_attribute`, a colour."""
        return self.eval_attribute(name, si, active)

    def _attribute(self, name: str) -> Any:
        """The texture or number that `traverse` reports under a name; None if there is none."""
        listing = Attributes(self)
        self.traverse(listing)
        return listing.found.get(name)

    def _known_attribute(self, name: str) -> Any:
        found = self._attribute(name)
        if found is None:
            listing = Attributes(self)
            self.traverse(listing)
            raise RenderError(f"{self.id()}: there is no attribute '{name}'{near_miss(name, listing.found)}")
        return found

    def sh_frame(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Frame3f:
        """The shading frame that the BSDF works in, in world space: that of `si` unless the BSDF tilts it."""
        return si.sh_frame

    def has_jumps(self, interpolated: bool = False) -> bool:
        """True if values jump with the place, not only because textures do, or parts of a surface hide others.

        `interpolated`: on a mesh with interpolated normals, whose triangles cut off light that these face.
        """
        return False

    def needs_differentials(self) -> bool:
        """False: no BSDF looks at the rays of neighbouring pixels."""
        return False

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        """Sample `wo`; `sample1` picks the lobe, `sample2` the direction."""
        raise NotImplementedError

    def eval(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Color3f:
        """The value f(wi, wo) abs(cos theta_o)."""
        return self._both(ctx, si, wo, active)[0]

    def pdf(self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True) -> Float:
        """The density of `sample` at `wo`, per unit solid angle."""
        return self._both(ctx, si, wo, active)[1]

    def _both(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool
    ) -> tuple[Color3f, Float]:
        """Call `eval_pdf`, for a class that overrides neither `eval` nor `pdf`."""
        if type(self).eval_pdf is BSDF.eval_pdf:
            raise NotImplementedError(f"{type(self).__name__} needs eval and pdf, or eval_pdf")
        return self.eval_pdf(ctx, si, wo, active)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        """The results of `eval` and `pdf`: a class overrides either this method or both of those."""
        return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    def eval_pdf_both(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float, Float]:
        """`eval_pdf`, and the density with which `sample` gives `wi` where light arrives from `wo`.

        Estimators that build paths from both ends weight them by both densities.
        """
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        other = TransportMode.Importance if ctx.mode == TransportMode.Radiance else TransportMode.Radiance
        turned = si.replaced(wi=wo)
        return value, pdf, self.pdf(dataclasses.replace(ctx, mode=other), turned, si.wi, active)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        """The results of `eval_pdf` and `sample`: what a path vertex needs, in one call."""
        value, pdf = self.eval_pdf(ctx, si, wo, active)
        sample, weight = self.sample(ctx, si, sample1, sample2, active)
        return value, pdf, sample, weight

    def at_point(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        """The BSDF at `si`, seen from `si.wi`, to be evaluated and sampled: what BSDFs ask of those nested in them."""
        return CalledAtPoint(self, ctx, si, active)

    def eval_null_transmission(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The fraction of light that passes straight through the surface, by a `Null` lobe."""
        return Color3f(0)

    def transmittance(self, distance: Float) -> Color3f:
        """The fraction of light that is left after a distance within the body that the surface encloses."""
        return Color3f(1)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        """The albedo shown by the `aov` integrator: by default pi f from `wi` to the normal, as in Mitsuba."""
        return self.eval(BSDFContext(), si, Vector3f(0, 0, 1), active) * math.pi


class Attributes(TraversalCallback):
    """A traversal callback that collects textures, numbers and colours by name."""

    def __init__(self, plugin: Plugin) -> None:
        self._plugin = plugin
        self.found: dict[str, Any] = {}

    def put(self, name: str, value: Any, flags: Any = None, attribute: str | None = None) -> None:
        """Note a parameter: see `TraversalCallback.put`."""
        held = value if isinstance(value, Plugin) else getattr(self._plugin, attribute or name, value)
        if getattr(held, "kind", None) == "texture" or (dr.is_array_v(held) and dr.is_float_v(held)):
            self.found[name] = held


# ---- results of scripts: Python's numbers become Dr.Jit arrays ----------------------------


def as_sample(bs: BSDFSample3f) -> BSDFSample3f:
    """Convert a sample whose fields may be Python's numbers."""
    fields = bs.__dict__
    if all(type(fields.get(name)) is kind for name, kind in BSDFSample3f.DRJIT_STRUCT.items()):
        return bs
    return BSDFSample3f.of(Vector3f(bs.wo), bs.pdf, bs.sampled_type, eta=bs.eta, sampled_component=bs.sampled_component)


CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "sample": lambda r: (as_sample(r[0]), Color3f(r[1])),
    "eval": Color3f,
    "pdf": Float,
    "eval_pdf": lambda r: (Color3f(r[0]), Float(r[1])),
    "eval_pdf_sample": lambda r: (Color3f(r[0]), Float(r[1]), as_sample(r[2]), Color3f(r[3])),
    "eval_null_transmission": Color3f,
    "eval_diffuse_reflectance": Color3f,
    "transmittance": Color3f,
}


class BSDFAtPoint(Protocol):
    """A BSDF at one surface point, seen from one direction: arguments and results as in `BSDF`."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        """The value f abs(cos theta_o), and the density of `sample` at `wo`."""

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        """A sampled direction and its weight."""


class CalledAtPoint:
    """A BSDF at one point by its methods, for BSDFs that have no work to share between them."""

    def __init__(self, bsdf: BSDF, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> None:
        self._bsdf, self._ctx, self._si, self._active = bsdf, ctx, si, active

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        return self._bsdf.eval_pdf(self._ctx, self._si, wo, self._active)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        return self._bsdf.sample(self._ctx, self._si, sample1, sample2, self._active)


class BlackAtPoint:
    """A BSDF that scatters nothing: none of its lobes is asked for."""

    def eval_pdf(self, wo: Vector3f) -> tuple[Color3f, Float]:
        return Color3f(0), Float(0)

    def sample(self, sample1: Float, sample2: Point2f) -> tuple[BSDFSample3f, Color3f]:
        return BSDFSample3f.none(), Color3f(0)


class SharedWorkBSDF(BSDF):
    """A BSDF with one method to override, `at`, which computes once all that depends on `wi` and the point alone."""

    def at(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        """The BSDF at `si`, seen from `si.wi`."""
        raise NotImplementedError

    def at_point(self, ctx: BSDFContext, si: SurfaceInteraction3f, active: Bool | bool) -> BSDFAtPoint:
        return self.at(ctx, si, active) if self.is_asked(ctx) else BlackAtPoint()

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        return self.at_point(ctx, si, active).sample(sample1, sample2)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        return self.at_point(ctx, si, active).eval_pdf(wo)

    def eval_pdf_sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        wo: Vector3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Color3f, Float, BSDFSample3f, Color3f]:
        here = self.at_point(ctx, si, active)
        return *here.eval_pdf(wo), *here.sample(sample1, sample2)


class DeltaBSDF(BSDF):
    """A BSDF whose lobes are all delta distributions: only `sample` finds their directions, `eval` and `pdf` are 0."""

    def bounce(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, sample1: Float, active: Bool | bool
    ) -> tuple[BSDFSample3f, Color3f]:
        """The result of `sample` where a lobe is asked for: what to override."""
        raise NotImplementedError

    def sample(
        self,
        ctx: BSDFContext,
        si: SurfaceInteraction3f,
        sample1: Float,
        sample2: Point2f,
        active: Bool | bool = True,
    ) -> tuple[BSDFSample3f, Color3f]:
        return self.bounce(ctx, si, sample1, active) if self.is_asked(ctx) else BlackAtPoint().sample(sample1, sample2)

    def eval_pdf(
        self, ctx: BSDFContext, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
    ) -> tuple[Color3f, Float]:
        return Color3f(0), Float(0)


def nested_bsdfs(props: Properties, count: int) -> list[Any]:
    """The BSDFs that a description nests under any keys, in its order; raises `SceneError` unless there are `count`."""
    found = [plugin for _, plugin in props.children("bsdf")]
    if len(found) != count:
        number = ("no", "one", "two")[count]
        plural = "" if count == 1 else "s"
        raise SceneError(
            f"{props.node}: '{props.plugin_name()}' takes {number} nested BSDF{plural}, found {len(found)}"
        )
    return found


class NestingBSDF(SharedWorkBSDF):
    """A BSDF that changes one other, `nested_bsdf`: the body has the matter of that one, and its albedo is shown."""

    children: ClassVar[Sequence[str]] = ("nested_bsdf",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        (nested,) = nested_bsdfs(props, 1)
        self.nested_bsdf: BSDF = nested
        self.absorbs = self.nested_bsdf.absorbs

    def transmittance(self, distance: Float) -> Color3f:
        return self.nested_bsdf.transmittance(distance)

    def eval_diffuse_reflectance(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Color3f:
        return self.nested_bsdf.eval_diffuse_reflectance(si, active)


def derivative_of_choice(probability: Float) -> Float:
    """The number 1 with the derivative of `probability` / detach(`probability`).

    A factor of the weight of a lobe that was chosen with this probability because it carries this fraction of the
    light: the choice isn't differentiated, the fraction must be.
    """
    if not dr.grad_enabled(probability):
        return Float(1)
    share = probability * dr.rcp(dr.select(probability > 0, dr.detach(probability), 1))
    return dr.replace_grad(Float(1), share)  # type: ignore[func-returns-value, return-value]


FROM_LIGHT, FROM_CAMERA = BSDFContext(TransportMode.Importance), BSDFContext()


def eval_pdf_light(
    bsdf: BSDF, si: SurfaceInteraction3f, wo: Vector3f, active: Bool | bool = True
) -> tuple[Color3f, Float, Float]:
    """The factor of flux that arrives from `si.wi`, per solid angle of `wo`, and the densities of both ways.

    The value is f(wo, wi) abs(cos(wi, ns) cos(wo, ng) / cos(wi, ng)): that of a path from the camera, which comes from
    `wo` and goes on to `wi`, with the cosines that light sees. ns is the shading normal, ng the geometric one; it is 0
    where the two disagree on a direction's side. The densities are that of `sample_light` at `wo`, and that with which
    a path from the camera, coming from `wo`, goes on to `si.wi`.

    E. Veach, "Robust Monte Carlo Methods for Light Transport Simulation", 1997, 5.3.2.
    """
    value, back = bsdf.eval_pdf(FROM_CAMERA, si.replaced(wi=wo), si.wi, active)
    return value * dr.abs(geometric_ratio(si, wo)), bsdf.pdf(FROM_LIGHT, si, wo, active), back


def sample_light(
    bsdf: BSDF, si: SurfaceInteraction3f, sample1: Float, sample2: Point2f, active: Bool | bool = True
) -> tuple[BSDFSample3f, Color3f]:
    """Sample a direction for light that arrives from `si.wi`, with the value of `eval_pdf_light` over the density."""
    bs, weight = bsdf.sample(FROM_LIGHT, si, sample1, sample2, active)
    ratio = geometric_ratio(si, bs.wo)
    corrected = weight * dr.select(ratio != 0, dr.abs(si.wi.z * ratio * dr.rcp(bs.wo.z)), 0)
    if bsdf.is_symmetric:
        return bs, corrected
    value, _, _ = eval_pdf_light(bsdf, si, bs.wo, active)
    exact = dr.select(bs.pdf > 0, value * dr.rcp(bs.pdf), 0)
    return bs, dr.select(has_flag(bs.sampled_type, BSDFFlags.Delta), corrected, exact)


def geometric_ratio(si: SurfaceInteraction3f, wo: Vector3f) -> Float:
    """cos(wo, ng) / cos(wi, ng); 0 where shading and geometric normal disagree on the side of `si.wi` or `wo`."""
    n = si.sh_frame.to_local(si.n)
    wi_cos, wo_cos = dr.dot(n, si.wi), dr.dot(n, wo)
    ok = (wi_cos * si.wi.z > 0) & (wo_cos * wo.z > 0)
    return dr.select(ok, wo_cos * dr.rcp(dr.select(ok, wi_cos, 1)), 0)
