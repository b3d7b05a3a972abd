"""The pinhole camera with the distortion of a real lens."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_number
from djpt.core.records import DirectionSample3f, Ray3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.sensors.perspective import OFFSETS, Perspective

__all__ = ["COEFFICIENTS", "PIXELS", "DistortedPerspective"]

COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
PIXELS = ("fx", "fy", "cx", "cy")
STEPS, STEPS_TO_RIM = 7, 20
"""Steps of Newton's method from a place on the film to a direction: inside of a picture, and if its rim is on the film,
where the distortion hardly grows."""
RESIDUE = 2e-6
"""The largest error, in focal lengths, that they may leave."""
DIRECTIONS, BISECTIONS = 48, 20
"""In so many directions it is found out where the picture folds, to so many bits of a step."""
SHOWN = 0.995
"""The radius of what the lens shows over that at which the picture folds."""


class DistortedPerspective(Perspective):
    """A `perspective` camera with the distortion of a real lens (Brown and Conrady), in OpenCV's form.

    A direction with the ideal image (x, y), in focal lengths, x to the right and y down, is shown at

        (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
            + (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y),    r^2 = x^2 + y^2

    Parameters, besides those of `perspective`: `k1` .. `k6`, `p1`, `p2` (default 0); `fx`, `fy` (default `fx`), `cx`
    and `cy` (default: the middle), in pixels of the whole film, from its upper left corner (pixel centres lie at
    halves), in place of `fov` and the principal point. `fov` is that of the ideal image.

    The lens shows the largest disk of the ideal image about the optical axis in which no two directions are shown at
    the same place. A film that reaches past its picture is black there, with an alpha of 0.

    Source: D. C. Brown, "Decentering Distortion of Lenses", Photogrammetric Engineering 32 (1966).
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **Perspective.values,
        **dict.fromkeys(
            (*COEFFICIENTS, "axis_x", "axis_y", "axis_z", "start", "step", "rim"), ParamFlags.NonDifferentiable
        ),
    }
    statics = ("has_image_circle",)
    density_moves = False
    lens: ClassVar[tuple[str, ...]] = ("pixel_aspect", *COEFFICIENTS)
    motions = (*Perspective.motions, *lens)

    k1: Float
    k2: Float
    k3: Float
    k4: Float
    k5: Float
    k6: Float
    p1: Float
    p2: Float
    pixel_aspect: Float
    """The height of a pixel, in widths."""
    start: Point2f
    """The point of the image plane that film position (0, 0) shows, in camera space."""
    step: Point2f
    fold: float | None
    """The angle at which the picture folds first."""
    rim: Float
    """The radius of what the lens shows, in the ideal image; only if the film reaches past it."""
    axis_x: Vector3f
    axis_y: Vector3f
    axis_z: Vector3f

    def __init__(self, props: Properties) -> None:
        for name in COEFFICIENTS:
            setattr(self, name, as_float(props.float(name, 0.0)))
        self.pixel_aspect = Float(1)
        super().__init__(props)

    def field_of_view(self, props: Properties) -> float:
        if not any(name in props for name in PIXELS):
            return super().field_of_view(props)
        if "fov" in props or "focal_length" in props:
            raise props.error("fx", "can't be given together with 'fov' or 'focal_length'")
        fx = props.float("fx", low=0.0, low_open=True)
        fy = props.float("fy", fx, low=0.0, low_open=True)
        self.pixel_aspect = Float(fx / fy)
        return math.degrees(2 * math.atan(self.film().size()[0] / (2 * fx)))

    def image_centre(self, props: Properties) -> tuple[float, float]:
        width, height = self.film().size()
        x, y = super().image_centre(props)
        return x + 0.5 - props.float("cx", width / 2) / width, y + 0.5 - props.float("cy", height / 2) / height

    def place(self) -> None:
        super().place()
        linear = self.to_world.matrix[:3, :3]
        self.axis_x, self.axis_y, self.axis_z = (Vector3f(*map(as_float, linear[:, k])) for k in range(3))
        values = {name: float(dr.detach(getattr(self, name))[0]) for name in ("x_fov", *OFFSETS, "pixel_aspect")}
        start, step = self.plane_window(values)
        self.start, self.step = Point2f(*map(as_float, start)), Point2f(*map(as_float, step))
        self.inv_area = as_float(1 / abs(step[0] * step[1]))
        self.has_image_circle, self.rim, self.fold = False, as_float(1e9), None
        if not self.has_inverse(np.array(start), np.array(step)):
            self.has_image_circle, self.rim = True, as_float(self.last_radius())

    def plane_window(self, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """The film's corner and sides on the plane at distance 1: pairs of numbers, or of `Float`."""
        film = self.film()
        size, crop, offset = film.size(), film.crop_size(), film.crop_offset()
        half = dr.tan(values["x_fov"] * (math.pi / 360))
        reach = (half, half * values["pixel_aspect"] * (int(size[1]) / int(size[0])))
        shift = tuple(values[name] for name in OFFSETS)
        start = [(1 - 2 * (shift[k] + int(offset[k]) / int(size[k]))) * reach[k] for k in range(2)]
        return start, [-2 * reach[k] * (int(crop[k]) / int(size[k])) for k in range(2)]

    def has_inverse(self, start: NDArray[np.float64], step: NDArray[np.float64]) -> bool:
        """Whether each place on the film shows one direction."""
        u = np.linspace(0, 1, 33)
        places = start[:, None] + step[:, None] * np.stack(np.meshgrid(u, u)).reshape(2, -1)
        shown = Point2f(places.astype(np.float32))
        ideal = self.ideal(shown)
        again, slopes = self.distorted(ideal)
        determinant = slopes[0] * slopes[2] - dr.square(slopes[1])
        error = float(np.abs(np.array(again) - np.array(shown)).max())
        return error <= RESIDUE * max(1.0, float(np.abs(places).max())) and float(np.array(determinant).min()) > 0

    def last_radius(self) -> float:
        """The radius of what the lens shows, in the ideal image: a little less than where the picture folds."""
        radius, angle = np.linspace(0, 20, 4001), np.linspace(0, 2 * math.pi, DIRECTIONS, endpoint=False)
        grows = self.grows(radius, angle[:, None])
        folds = ~grows.all(axis=0)
        if not folds.any():
            return float(SHOWN * radius[-1])
        first = int(folds.argmax())
        self.fold = float(angle[(~grows[:, first]).argmax()])
        # Between two steps: of all directions that in which it folds first.
        low, high = float(radius[max(first - 1, 0)]), float(radius[first])
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            found = self.grows(np.array([middle]), angle[:, None])[:, 0]
            if found.all():
                low = middle
            else:
                high, self.fold = middle, float(angle[(~found).argmax()])
        return SHOWN * high

    def grows(self, radius: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether the picture doesn't fold at places of the ideal image."""
        places = np.stack(np.broadcast_arrays(radius, angle)).astype(np.float32)
        with dr.suspend_grad():
            found = np.array(self.determinant(*(Float(values.ravel()) for values in places)))
        return (np.isfinite(found) & (found > 0)).reshape(places.shape[1:])

    def moved_rim(self, values: Mapping[str, Any]) -> Float:
        """`rim`, attached to coefficients: where the determinant of the map's derivatives is 0 in one direction."""
        rim = dr.detach(self.rim)
        if self.fold is None:
            return rim
        view, radius = copy.copy(self), rim / SHOWN
        for name in self.lens:
            setattr(view, name, dr.detach(getattr(self, name)))
        dr.enable_grad(radius)
        dr.set_grad(radius, 1)
        slope = dr.forward_to(view.determinant(radius, self.fold), flags=dr.ADFlag.ClearEdges)
        for name, value in values.items():
            setattr(view, name, value)
        change = view.determinant(rim / SHOWN, self.fold)
        return rim - (change - dr.detach(change)) * (SHOWN / slope)

    def determinant(self, radius: Float, angle: Float | float) -> Float:
        """How much larger areas are shown than in the ideal image; 0 where the picture folds."""
        sin, cos = dr.sincos(Float(angle))
        _, (xx, xy, yy) = self.distorted(Point2f(radius * cos, radius * sin))
        return xx * yy - dr.square(xy)

    # ---- parameters --------------------------------------------------------------------

    def traverse_lens(self, callback: TraversalCallback) -> None:
        super().traverse_lens(callback)
        for name in self.lens:
            callback.put(name, getattr(self, name), self.motion_flags(name))

    def check_parameter(self, name: str, value: Any) -> Any:
        if name not in self.lens:
            return super().check_parameter(name, value)
        number = as_number(dr.detach(value))
        if name in ("pixel_aspect", "eta") and number <= 0:
            raise ParameterError(f"must be greater than 0, found {number:g}")
        return Float(value) if dr.grad_enabled(value) else dr.opaque(Float, number)

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import columns  # images of still cameras need none of it

        x, y, z, origin = columns(self, values)
        known = {name: dr.detach(getattr(self, name)) for name in ("x_fov", *OFFSETS, "pixel_aspect")}
        start, step = self.plane_window({**known, **{k: v for k, v in values.items() if k in known}})
        placed = {"origin": origin, "axis_x": x, "axis_y": y, "axis_z": z, "axis": z}
        of_lens = {name: value for name, value in values.items() if name in self.lens and name in type(self).values}
        moved = {**placed, "start": Point2f(*start), "step": Point2f(*step), **of_lens}
        return {**moved, "rim": self.moved_rim(of_lens)} if self.has_image_circle and of_lens else moved

    # ---- the lens ------------------------------------------------------------------------

    def distorted(self, q: Point2f) -> tuple[Point2f, tuple[Float, Float, Float]]:
        """The place on the image plane of an ideal image, in camera space, and the derivatives xx, xy and yy.

        Camera space has x to the left and y up: `p1` and `p2` change their signs.
        """
        x, y, r2 = q.x, q.y, dr.squared_norm(q)
        over = dr.fma(r2, dr.fma(r2, dr.fma(r2, self.k3, self.k2), self.k1), 1)
        under = dr.rcp(dr.fma(r2, dr.fma(r2, dr.fma(r2, self.k6, self.k5), self.k4), 1))
        radial = over * under
        # The derivative by r^2.
        growth = dr.fma(r2, dr.fma(r2, 3 * self.k3, 2 * self.k2), self.k1)
        slope = (growth - radial * dr.fma(r2, dr.fma(r2, 3 * self.k6, 2 * self.k5), self.k4)) * under
        p1, p2 = -self.p1, -self.p2
        place = Point2f(
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        )
        xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        return place, (xx, xy, yy)

    def ideal(self, place: Point2f) -> Point2f:
        """The ideal image of what a place on the image plane shows: the inverse of `distorted`.

        Its derivatives, also by the coefficients, are those of one step of Newton's method from the solution.
        """
        with dr.suspend_grad():
            fixed = dr.detach(place)
            q = fixed
            if self.has_image_circle:
                q = q * dr.minimum(1, dr.detach(self.rim) * dr.rsqrt(dr.maximum(dr.squared_norm(q), 1e-20)))
            for _ in range(STEPS_TO_RIM if self.has_image_circle else STEPS):
                q = self.nearer(q, fixed)
        return self.nearer(dr.detach(q), place)

    def nearer(self, q: Point2f, place: Point2f) -> Point2f:
        """A step of Newton's method towards the ideal image of a place."""
        found, slopes = self.distorted(q)
        xx, xy, yy = (dr.detach(slope) for slope in slopes)
        determinant = xx * yy - dr.square(xy)
        inverse = dr.rcp(dr.select(dr.abs(determinant) > 1e-4, determinant, 1e-4))
        dx, dy = found.x - place.x, found.y - place.y
        return Point2f(q.x - (yy * dx - xy * dy) * inverse, q.y - (xx * dy - xy * dx) * inverse)

    # ---- in kernels --------------------------------------------------------------------

    def middle(self) -> Point2f:
        return Point2f(-self.start.x / self.step.x, -self.start.y / self.step.y)

    def edge_of_view(self, turn: Float) -> Point2f:
        sin, cos = dr.sincos(2 * math.pi * turn)
        place, _ = self.distorted(Point2f(self.rim * cos, self.rim * sin))
        return Point2f((place.x - self.start.x) / self.step.x, (place.y - self.start.y) / self.step.y)

    def in_circle(self, q: Point2f) -> Bool:
        """Whether an ideal image lies within what the lens shows."""
        return dr.squared_norm(dr.detach(q)) < dr.square(dr.detach(self.rim))

    def shows(self, film_position: Point2f) -> Bool:
        """Whether a place on the film shows anything."""
        place = dr.detach(dr.fma(self.step, film_position, self.start))
        with dr.suspend_grad():
            q = self.ideal(place)
            error = dr.squared_norm(self.distorted(q)[0] - place)
        return self.in_circle(q) & (error <= dr.square(10 * RESIDUE) * (1 + dr.squared_norm(place)))

    def ray_through(self, film_position: Point2f, aperture_sample: Point2f, active: Bool | bool = True) -> Ray3f:
        if not self.has_image_circle:
            return super().ray_through(film_position, aperture_sample, active)
        shown = self.shows(film_position)
        # Beside the picture a ray of no length sets out along the optical axis.
        ray = super().ray_through(dr.select(shown, film_position, -self.start / self.step), aperture_sample, active)
        return ray.replaced(maxt=dr.select(shown, ray.maxt, 0))

    def through_centre(self, film_position: Point2f) -> Vector3f:
        q = self.ideal(dr.fma(self.step, film_position, self.start))
        return dr.fma(self.axis_x, q.x, dr.fma(self.axis_y, q.y, self.axis_z))

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        to_ref = ref - self.origin
        z = dr.dot(to_ref, self.axis_z)
        in_range = (z > self.near) & (z < self.near + self.depth)
        inv_z = dr.rcp(dr.select(in_range, z, 1))
        m = to_ref * inv_z
        q = Point2f(dr.dot(m, self.axis_x), dr.dot(m, self.axis_y))
        place, slopes = self.distorted(q)
        determinant = slopes[0] * slopes[2] - dr.square(slopes[1])
        uv = Point2f((place.x - self.start.x) / self.step.x, (place.y - self.start.y) / self.step.y)
        seen = in_range & (determinant > 0) & (uv.x >= 0) & (uv.x < 1) & (uv.y >= 0) & (uv.y < 1)
        # Far outside, the polynomials may lead back into the picture.
        if self.has_image_circle:
            seen &= self.in_circle(q)
            uv = dr.select(self.in_circle(q), uv, -1)
        else:
            back = self.ideal(place)
            seen &= dr.squared_norm(back - q) < 1e-4 * (1 + dr.squared_norm(q))
        length = dr.norm(m)
        ds = DirectionSample3f.of(
            p=dr.fma(m, self.near, self.origin),
            n=self.axis,
            uv=uv,
            d=m * -dr.rcp(length),
            dist=(z - self.near) * length,
            pdf=Float(1),
            weight=Float(1),
            delta=Bool(True),
            emitter_index=UInt32(0),
        )
        return ds, dr.select(seen, length * dr.square(inv_z) * self.inv_area * determinant, 0)

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """See `Central`; the density on the ideal image times how much larger the shown one is there."""
        pdf, distance = super().pdf_ray(ray)
        inverse = dr.rcp(dr.dot(ray.d, self.axis_z))
        q = Point2f(dr.dot(ray.d, self.axis_x) * inverse, dr.dot(ray.d, self.axis_y) * inverse)
        _, (xx, xy, yy) = self.distorted(q)
        return pdf * (xx * yy - dr.square(xy)), distance
