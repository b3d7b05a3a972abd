"""Rays and directions of sensors as scripts ask for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.core.records import DirectionSample3f, Ray3f
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f

if TYPE_CHECKING:
    from djpt.errors import RenderError
    from djpt.films.base import Film

__all__ = ["SampledRays"]


class SampledRays:
    """Mitsuba's methods of sensors, in terms of `ray_through` and `sample_wi`.

    Numbers and vectors of arguments may be Python's. What is called a weight is the factor from radiance to what the
    sensor measures.
    """

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        """See `Sensor`."""
        raise NotImplementedError

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        """See `Sensor`."""
        raise NotImplementedError

    is_pinhole: ClassVar[bool] = False
    """Whether all rays meet in one point: those of differentials are then given the origin of the ray itself."""

    if TYPE_CHECKING:
        weight: float
        uses_aperture: bool
        has_image_circle: bool
        has_neighbours: ClassVar[bool]

        def film(self) -> Film:
            """See `Sensor`."""

        @property
        def moves(self) -> bool:
            """See `Sensor`."""

        def ray_at(
            self, time: Float, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True
        ) -> Ray3f:
            """See `Sensor`."""

        def unanswered(self, what: str) -> RenderError:
            """See `djpt.Endpoint`."""

    def needs_aperture_sample(self) -> bool:
        """Whether rays depend on the aperture sample."""
        return self.uses_aperture

    def sample_ray(
        self,
        time: Float | float,
        sample1: Float | float,
        sample2: Point2f,
        sample3: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Ray3f, Color3f]:
        """Sample a ray of the sensor, and its weight, which is 0 where the lens shows nothing.

        Args:
            time: the ray's time.
            sample1: chooses wavelengths in other renderers; without effect.
            sample2: the position in [0, 1]^2 of the film's crop window, y downwards.
            sample3: the sample for the aperture, in [0, 1)^2.
            active: lanes that are needed; on others the results mean nothing.
        """
        ray = self.ray_at(Float(time), Point2f(sample2), Point2f(sample3), active)
        weight = Color3f(self.weight)
        return ray, dr.select(ray.maxt > 0, weight, 0) if self.has_image_circle else weight

    def sample_ray_differential(
        self,
        time: Float | float,
        sample1: Float | float,
        sample2: Point2f,
        sample3: Point2f,
        active: Bool | bool = True,
    ) -> tuple[Any, Color3f]:
        """Sample a ray as `sample_ray` does, with those through the next pixel to the right and the next one below.

        A sensor of a single ray has no others: `has_differentials` is false then.
        """
        at = Point2f(sample2)
        width, height = self.film().crop_size()
        ray, weight = self.sample_ray(time, sample1, at, sample3, active)
        right, _ = self.sample_ray(time, sample1, Point2f(at.x + 1 / width, at.y), sample3, active)
        below, _ = self.sample_ray(time, sample1, Point2f(at.x, at.y + 1 / height), sample3, active)
        from djpt.core.records.rays import RayDifferential3f  # the renderer knows no differentials

        result = RayDifferential3f(ray)
        result.d_x, result.d_y = right.d, below.d
        result.o_x, result.o_y = (ray.o, ray.o) if self.is_pinhole else (right.o, below.o)
        result.has_differentials = self.has_neighbours
        return result, weight

    def sample_direction(
        self, it: Any, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """Sample the way from a point, or from where an interaction lies, to the sensor; and its importance.

        As `sample_wi`, but `ds.uv` is the position on the crop window in pixels. The importance is 0 on lanes that
        aren't active.
        """
        if self.moves:
            raise self.unanswered("no directions while it moves: ask the sensors of scene.at_time(t)")
        ds, importance = self.sample_wi(Point3f(getattr(it, "p", it)), Point2f(sample), active)
        ds.uv = ds.uv * Point2f(self.film().crop_size())
        return ds, Color3f(dr.select(active, importance, 0))

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> Any:
        """Raise `RenderError`: cameras have no surface to sample."""
        raise self.unanswered("no surface to sample")

    def sample_wavelengths(
        self, si: Any, sample: Float | float, active: Bool | bool = True
    ) -> tuple[list[Float], Color3f]:
        """No wavelengths, with weight 1: colours are red, green and blue here."""
        return [], Color3f(1)
