"""Adapters: what plugins sample, and the density of it, as functions for `ChiSquareTest`.

A plugin is given by its dictionary, or by its type and XML text with its parameters, in which %-fields are filled from
the arguments of the functions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, DirectionSample3f, PhaseFunctionContext, SurfaceInteraction3f
from djpt.core.records.media import MediumInteraction3f
from djpt.description.loader import load_dict
from djpt.description.scene_files import load_string
from djpt.errors import DjptError
from djpt.jit.types import Bool, Float, Point2f, Vector3f
from djpt.mitsuba.microfacet import MicrofacetDistribution

__all__ = ["BSDFAdapter", "EmitterAdapter", "MicrofacetAdapter", "PhaseFunctionAdapter", "SpectrumAdapter"]

Functions = tuple[Callable[..., Any], Callable[..., Any]]


def plugin(tag: str, kind: str, extra: Any, arguments: tuple[Any, ...]) -> Any:
    """The plugin that an adapter is about."""
    if isinstance(extra, dict):
        return load_dict(extra)
    text = extra % arguments if arguments else extra
    return load_string(f'<{tag} version="3.0.0" type="{kind}">{text}</{tag}>')


def BSDFAdapter(
    bsdf_type: str, extra: Any, wi: Sequence[float] = (0, 0, 1), uv: Sequence[float] = (0.5, 0.5), ctx: Any = None
) -> Functions:
    """Directions that a BSDF scatters to, by three uniform numbers; samples of weight 0 don't count.

    Args:
        bsdf_type: the type of the plugin.
        extra: its dictionary, or XML text with its parameters.
        wi: where the light comes from, in local coordinates.
        uv: where on the surface.
        ctx: which lobes are asked for.
    """
    context = BSDFContext() if ctx is None else ctx

    def interaction(lanes: int) -> SurfaceInteraction3f:
        si = dr.zeros(SurfaceInteraction3f, lanes)
        si.wi = Vector3f(wi)
        si.uv = Point2f(uv)
        return si

    def sample(numbers: Any, *arguments: Any) -> tuple[Vector3f, Float]:
        bsdf = plugin("bsdf", bsdf_type, extra, arguments)
        si = interaction(dr.width(numbers))
        found, weight = bsdf.sample(context, si, numbers[0], Point2f(numbers[1], numbers[2]), Bool(True))
        return found.wo, dr.select(dr.all(weight == 0), Float(0), 1) + dr.zeros(Float, dr.width(numbers))

    def density(wo: Vector3f, *arguments: Any) -> Float:
        bsdf = plugin("bsdf", bsdf_type, extra, arguments)
        return bsdf.pdf(context, interaction(dr.width(wo)), wo, Bool(True))

    return sample, density


def EmitterAdapter(emitter_type: str, extra: Any) -> Functions:
    """Directions from the origin to points of a light, by two uniform numbers.

    Args:
        emitter_type: the type of the plugin.
        extra: its dictionary, or XML text with its parameters.
    """

    def sample(numbers: Any, *arguments: Any) -> Vector3f:
        emitter = plugin("emitter", emitter_type, extra, arguments)
        return emitter.sample_direction(dr.zeros(SurfaceInteraction3f), numbers, Bool(True))[0].d

    def density(wo: Vector3f, *arguments: Any) -> Float:
        emitter = plugin("emitter", emitter_type, extra, arguments)
        ds = dr.zeros(DirectionSample3f, dr.width(wo))
        ds.d = wo
        return emitter.pdf_direction(dr.zeros(SurfaceInteraction3f), ds, Bool(True))

    return sample, density


def MicrofacetAdapter(md_type: Any, alpha: float, sample_visible: bool = False) -> Functions:
    """Normals of a `MicrofacetDistribution`, by two uniform numbers.

    Both functions take an angle in degrees, between +z and where the light comes from (default 0).
    """

    def seen(arguments: tuple[Any, ...]) -> tuple[MicrofacetDistribution, Vector3f]:
        angle = arguments[0] * dr.pi / 180 if arguments else 0.0
        return MicrofacetDistribution(md_type, alpha, sample_visible), Vector3f(dr.sin(angle), 0, dr.cos(angle))

    def sample(numbers: Any, *arguments: Any) -> Any:
        distribution, wi = seen(arguments)
        return distribution.sample(wi, numbers)[0]

    def density(m: Vector3f, *arguments: Any) -> Float:
        distribution, wi = seen(arguments)
        return distribution.pdf(wi, m)

    return sample, density


def PhaseFunctionAdapter(phase_type: str, extra: Any, wi: Sequence[float] = (0, 0, 1), ctx: Any = None) -> Functions:
    """Directions that a phase function scatters to, by three uniform numbers.

    Args:
        phase_type: the type of the plugin.
        extra: its dictionary, or XML text with its parameters.
        wi: where the light comes from.
        ctx: which components are asked for.
    """
    context = PhaseFunctionContext() if ctx is None else ctx

    def interaction(lanes: int) -> MediumInteraction3f:
        mi = dr.zeros(MediumInteraction3f, lanes)
        mi.wi = Vector3f(wi)
        mi.sh_frame = Frame3f.from_normal(mi.wi)
        return mi

    def sample(numbers: Any, *arguments: Any) -> tuple[Vector3f, Float]:
        phase = plugin("phase", phase_type, extra, arguments)
        mi = interaction(dr.width(numbers))
        wo, _, pdf = phase.sample(context, mi, numbers[0], Point2f(numbers[1], numbers[2]), Bool(True))
        return wo, dr.select(pdf == 0, Float(0), 1) + dr.zeros(Float, dr.width(numbers))

    def density(wo: Vector3f, *arguments: Any) -> Float:
        phase = plugin("phase", phase_type, extra, arguments)
        pdf = phase.eval_pdf(context, interaction(dr.width(wo)), wo, Bool(True))[1]
        return pdf + dr.zeros(Float, dr.width(wo))

    return sample, density


def SpectrumAdapter(value: Any) -> Functions:
    """Mitsuba's adapter of spectra.

    Raises:
        DjptError: always: djpt computes with colours, and no wavelengths are sampled.
    """
    raise DjptError("SpectrumAdapter: djpt renders with colours (rgb): there are no wavelengths to sample")
