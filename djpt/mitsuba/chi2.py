"""Pearson's chi-squared test that a sampling method follows the density that is claimed for it.

Adapters give what plugins sample, and the density of it, as functions for `ChiSquareTest`. A plugin is given by its
dictionary, or by its type and XML text with its parameters, in which %-fields are filled from the arguments of the
functions. The names of `djpt.chi2`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import drjit as dr
import numpy as np

from djpt.core.frame import Frame3f
from djpt.core.records import BSDFContext, DirectionSample3f, PhaseFunctionContext, SurfaceInteraction3f
from djpt.core.records.interactions import MediumInteraction3f
from djpt.description.loader import load_dict, load_string
from djpt.errors import ArgumentError, DjptError
from djpt.jit.types import PCG32, Bool, Float, Point2f, UInt32, UInt64, Vector2f, Vector3f, backend
from djpt.mitsuba.fresnel import MicrofacetDistribution
from djpt.mitsuba.math import chi2, rlgamma
from djpt.samplers.seeds import sample_tea_32

__all__ = [
    "BSDFAdapter",
    "ChiSquareTest",
    "EmitterAdapter",
    "LineDomain",
    "MicrofacetAdapter",
    "PhaseFunctionAdapter",
    "PlanarDomain",
    "SpectrumAdapter",
    "SphericalDomain",
]

LEAST_FREQUENCY = 5
"""Cells that fewer samples are expected in are pooled: the statistic takes counts to be nearly normal."""


class Rectangle:
    """A bounding box of coordinates."""

    def __init__(self, min: Any, max: Any) -> None:
        self.min = dr.scalar.Array2f64(min)
        self.max = dr.scalar.Array2f64(max)

    def extents(self) -> Any:
        """The width and the height."""
        return self.max - self.min


class Domain(Protocol):
    """Coordinates of what a method samples, such that equal areas of coordinates mean equal measures."""

    def bounds(self) -> Any:
        """The range of the coordinates: `min`, `max` and `extents()` of two numbers."""
        ...

    def aspect(self) -> float | None:
        """Width over height of the cells' range, or None if the second coordinate means nothing."""
        ...

    def map_forward(self, p: Vector2f) -> Any:
        """Coordinates to values."""
        ...

    def map_backward(self, p: Any) -> Vector2f:
        """Values to coordinates."""
        ...


class LineDomain:
    """Numbers between two bounds."""

    def __init__(self, bounds: Sequence[float] = (-1.0, 1.0)) -> None:
        low, high = bounds
        self._bounds = Rectangle((low, -0.5), (high, 0.5))

    def bounds(self) -> Any:
        """The bounds, and (-0.5, 0.5) for the second coordinate."""
        return self._bounds

    def aspect(self) -> float | None:
        """Return None: there is one coordinate."""
        return None

    def map_forward(self, p: Any) -> Float:
        """The first coordinate."""
        return p.x

    def map_backward(self, p: Any) -> Vector2f:
        """The number, and 0."""
        number = p if dr.depth_v(p) == 1 else p.x
        return Vector2f(number, dr.zeros(Float, dr.width(number)))


class PlanarDomain:
    """Points of a rectangle, [-1, 1]^2 by default; `bounds` is a bounding box."""

    def __init__(self, bounds: Any = None) -> None:
        self._bounds = Rectangle(-1, 1) if bounds is None else Rectangle(bounds.min, bounds.max)

    def bounds(self) -> Any:
        """The rectangle."""
        return self._bounds

    def aspect(self) -> float | None:
        """Width over height."""
        width, height = self._bounds.extents()
        return float(width / height)

    def map_forward(self, p: Any) -> Any:
        """The point itself."""
        return p

    def map_backward(self, p: Any) -> Any:
        """The point itself."""
        return p


class SphericalDomain:
    """Directions by their azimuth in [-pi, pi] and the cosine -z: equal areas, by Archimedes."""

    def bounds(self) -> Any:
        """The range of both coordinates."""
        return Rectangle((-dr.pi, -1), (dr.pi, 1))

    def aspect(self) -> float | None:
        """Return 2: there are twice as many cells in azimuth."""
        return 2

    def map_forward(self, p: Any) -> Vector3f:
        """The direction with these coordinates."""
        cos_theta = -p.y
        sin_theta = dr.safe_sqrt(dr.fma(-cos_theta, cos_theta, 1))
        sin_phi, cos_phi = dr.sincos(p.x)
        return Vector3f(cos_phi * sin_theta, sin_phi * sin_theta, cos_theta)

    def map_backward(self, p: Any) -> Vector2f:
        """The coordinates of a direction."""
        return Vector2f(dr.atan2(p.y, p.x), -p.z)


class ChiSquareTest:
    """Compare a histogram of samples with the integrals of a density over its cells.

    Args:
        domain: coordinates of the sampled values: `SphericalDomain()`, `PlanarDomain()`, `LineDomain()`.
        sample_func: takes uniform numbers, a vector of `sample_dim` components, and returns values, or a pair of values
            and weights: those of weight 0 don't count.
        pdf_func: the density that is claimed for the values.
        sample_dim: the number of uniform numbers per sample.
        sample_count: the number of samples.
        res: cells along the second coordinate; along the first one there are `res / domain.aspect()`.
        ires: points along either axis of a cell at which the density is integrated, by the trapezoidal rule.
        seed: of the uniform numbers.

    Attributes: `histogram` and `pdf`, counts and expected counts per cell; `p_value`; `messages`, a text.
    """

    histogram: Any
    pdf: Any
    p_value: float | None

    def __init__(
        self,
        domain: Domain,
        sample_func: Callable[..., Any],
        pdf_func: Callable[..., Any],
        sample_dim: int = 2,
        sample_count: int = 1000000,
        res: int = 101,
        ires: int = 4,
        seed: int = 0,
    ) -> None:
        if res < 1 or ires < 2:
            raise ArgumentError(f"ChiSquareTest: 'res' must be at least 1 and 'ires' 2, found {res} and {ires}")
        self.domain = domain
        self.sample_func = sample_func
        self.pdf_func = pdf_func
        self.sample_dim = sample_dim
        self.sample_count = sample_count
        aspect = domain.aspect()
        self.res = dr.scalar.Array2u(*((res, 1) if aspect is None else (max(int(res / aspect), 1), res)))
        self.ires = ires
        self.seed = seed
        self.bounds = domain.bounds()
        self.histogram = None
        self.pdf = None
        self.p_value = None
        self.messages = ""
        self.fail = False

    # ---- tables ------------------------------------------------------------------------------

    def tabulate_histogram(self) -> None:
        """Draw the samples and count them per cell."""
        found = self.sample_func(self._uniform())
        values, weights = found if isinstance(found, tuple) else (found, Float(1))
        place = self.domain.map_backward(values)
        low, extents = self._range()
        shares = [(x - a) / b for x, a, b in zip(place, low, extents, strict=True)]
        counts = Float(weights) != 0
        within = inside(shares[0]) & inside(shares[1])
        if not dr.all(within | ~counts):
            self._reject("samples lie outside of the domain")
        column, row = (UInt32(dr.clip(s * n, 0, n - 1)) for s, n in zip(shares, self.res, strict=True))
        self.histogram = dr.zeros(Float, self.res[0] * self.res[1])
        dr.scatter_add(self.histogram, Float(weights), row * self.res[0] + column, within & counts)
        self.histogram_sum = float(np.sum(self.histogram.numpy(), dtype=np.float64)) / self.sample_count
        self._check("histogram", self.histogram, self.histogram_sum)

    def _range(self) -> tuple[list[float], list[float]]:
        """The first coordinates, and the extents."""
        return [float(x) for x in self.bounds.min], [float(x) for x in self.bounds.extents()]

    def _uniform(self) -> Any:
        """The uniform numbers, a vector of `sample_dim` components."""
        index = dr.arange(UInt32, self.sample_count)
        state, stream = sample_tea_32(index, UInt32(self.seed))
        generator = PCG32(initstate=UInt64(state), initseq=UInt64(stream))
        numbers = getattr(backend, f"Array{self.sample_dim}f")()
        for axis in range(self.sample_dim):
            numbers[axis] = generator.next_float32()
        return numbers

    def tabulate_pdf(self) -> None:
        """Integrate the density over each cell, by the trapezoidal rule."""
        points = self.ires**2
        index = dr.arange(UInt32, self.res[0] * self.res[1] * points)
        cell, point = index // points, index % points
        low, extents = self._range()
        size = [extent / n for extent, n in zip(extents, self.res, strict=True)]
        spacing = [width / (self.ires - 1) for width in size]
        coordinates, weight = [], Float(spacing[0] * spacing[1] * self.sample_count)
        for axis in range(2):
            k = point % self.ires if axis == 0 else point // self.ires
            number = cell % self.res[0] if axis == 0 else cell // self.res[0]
            # Just inside of the cell, so that a density that ends at its edge ends there.
            along = (Float(k) + 1e-4) * (1 - 2e-4) * spacing[axis]
            coordinates.append(low[axis] + Float(number) * size[axis] + along)
            weight = weight * dr.select((k == 0) | (k == self.ires - 1), Float(0.5), 1)
        density = self.pdf_func(self.domain.map_forward(Point2f(*coordinates)))
        self.pdf = dr.block_sum(Float(density) * weight, points)
        self.pdf_sum = float(np.sum(self.pdf.numpy(), dtype=np.float64)) / self.sample_count
        self._check("density", self.pdf, self.pdf_sum)

    def _check(self, name: str, table: Float, total: float) -> None:
        least = float(dr.min(table)[0])
        if not least >= 0:
            self._reject(f"the {name} is negative in a cell: {least}")
        if total > 1.1:
            self._reject(f"the {name} adds up to more than 1: {total}")

    # ---- test --------------------------------------------------------------------------------

    def run(self, significance_level: float = 0.01, test_count: int = 1, quiet: bool = False) -> bool:
        """Whether the samples may have been drawn from the density.

        Args:
            significance_level: the chance of a false rejection.
            test_count: the number of tests that this chance is for, all together (Z. Sidak, 1967).
            quiet: don't print the messages.
        """
        if self.histogram is None:
            self.tabulate_histogram()
        if self.pdf is None:
            self.tabulate_pdf()
        counts, expected = self.histogram.numpy(), self.pdf.numpy()
        order = np.argsort(expected, kind="stable")
        statistic, freedom, rare, pooled = chi2(counts[order], expected[order], LEAST_FREQUENCY)
        if freedom < 1:
            self._reject("there are too few degrees of freedom")
        if ((expected == 0) & (counts != 0)).any():
            self._reject("there are samples in cells where the density is 0")
        if rare:
            self._log(f"{rare} cells with few samples are pooled into {pooled}")
        self._log(f"The histogram adds up to {self.histogram_sum:.6f}, the density to {self.pdf_sum:.6f}")
        self._log(f"Statistic {statistic:.3f} with {freedom} degrees of freedom")
        self.p_value = 1 - rlgamma(freedom / 2, statistic / 2) if freedom > 0 else float("nan")
        level = 1 - (1 - significance_level) ** (1 / test_count)
        accepted = not self.fail and self.p_value >= level
        verdict = "accepted" if accepted else "REJECTED"
        self._log(f"The hypothesis is {verdict}: p = {self.p_value:.6g}, significance level {level:.6g}")
        if not quiet:
            print(self.messages)
        return accepted

    def _reject(self, reason: str) -> None:
        self._log(f"Failure: {reason}")
        self.fail = True

    def _log(self, message: str) -> None:
        self.messages += message + "\n"


def inside(share: Float) -> Bool:
    """Whether a coordinate is within its range, but for rounding errors."""
    return (share >= -1e-4) & (share <= 1 + 1e-4)


# ---- adapters ------------------------------------------------------------------------------

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
