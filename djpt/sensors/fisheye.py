"""The fisheye: a camera that sees half of all directions, and more."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.numeric import as_number
from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_sensor
from djpt.errors import ParameterError, SceneError
from djpt.jit.kernels import as_float
from djpt.jit.types import Bool, Float, Point2f, Vector3f
from djpt.sensors.mapped import MappedCamera
from djpt.sensors.projective import fov_axis

__all__ = ["Fisheye"]

COEFFICIENTS = ("k1", "k2", "k3", "k4")
PIXELS = ("fx", "fy", "cx", "cy")
PROJECTIONS = ("equidistant", "equisolid", "stereographic", "orthographic")
LARGEST_FOV = {"equidistant": 360.0, "equisolid": 360.0, "stereographic": 360.0, "orthographic": 180.0}
STEPS = 8
"""Steps of Newton's method from a distance on the plane to an angle."""


class Fisheye(MappedCamera):
    """A camera that maps directions by their angle theta with the optical axis to distances rho from the centre.

    `projection` is one of

        equidistant     rho = theta (the default)
        equisolid       rho = 2 sin(theta / 2)     areas are in proportion to solid angles
        stereographic   rho = 2 tan(theta / 2)     angles are kept: small circles stay circles
        orthographic    rho = sin(theta)

    With any of `k1` .. `k4`, rho = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), the fisheye model of
    OpenCV, in place of a `projection`.

    Parameters, besides those of `MappedCamera`: `fov` (degrees, default 180: of the whole film along `fov_axis`, which
    is `x`, the default, `y`, `diagonal`, `smaller` or `larger`), or `fx`, `fy` (default `fx`), `cx` and `cy` (default:
    the middle) in pixels of the whole film, from its upper left corner: pixel centres lie at halves.
    `principal_point_offset_x`, `_y` (0) shift the image's centre, in image widths and heights, as in `perspective`.

    `image_circle` (degrees, at most 360 and by default so much) is the angle of the cone of directions that the lens
    shows, as far as its projection shows them. The film's corners may see more than `fov`; outside of the circle they
    are black, with an alpha of 0.

    Sources: K. Miyamoto, "Fish Eye Lens", J. Opt. Soc. Am. 54 (1964); J. Kannala, S. Brandt, "A Generic Camera Model
    and Calibration Method for Conventional, Wide-Angle, and Fish-Eye Lenses", IEEE TPAMI 28 (2006).
    """

    values: ClassVar[Mapping[str, ParamFlags]] = {
        **MappedCamera.values,
        **dict.fromkeys((*COEFFICIENTS, "rim", "last_theta"), ParamFlags.NonDifferentiable),
    }
    statics = ("projection", "has_image_circle")
    lens = ("x_focal", "y_focal", "principal_point_offset_x", "principal_point_offset_y", *COEFFICIENTS)
    motions = ("attached_matrix", *lens, "image_circle")
    in_any_frame = True
    image_circle: Float
    last_theta: Float
    """The angle of the last direction that is shown."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        width, height = self.film().size()
        given = [name for name in COEFFICIENTS if name in props]
        if given:
            if "projection" in props:
                raise props.error("projection", f"can't be given together with '{given[0]}'")
            self.projection = "polynomial"
        else:
            self.projection = props.string("projection", "equidistant", choices=PROJECTIONS)
        for name in COEFFICIENTS:
            setattr(self, name, as_float(props.float(name, 0.0) if given else 0.0))
        shift = [props.float(f"principal_point_offset_{axis}", 0.0) for axis in "xy"]
        if any(name in props for name in PIXELS):
            if "fov" in props:
                raise props.error("fov", "can't be given together with a focal length in pixels")
            fx = props.float("fx", low=0.0, low_open=True)
            fy = props.float("fy", fx, low=0.0, low_open=True)
            center = props.float("cx", width / 2), props.float("cy", height / 2)
            shift = [s + 0.5 - c / n for s, c, n in zip(shift, center, (width, height), strict=True)]
            self.x_focal, self.y_focal = Float(fx / width), Float(fy / height)
        else:
            most = LARGEST_FOV.get(self.projection, 360.0)
            fov = props.float("fov", 180.0, low=0.0, high=most, low_open=True, high_open=most == 360)
            if self.projection == "stereographic" and fov > 350:
                raise props.error("fov", f"must be at most 350 for a stereographic projection, found {fov:g}")
            axis = fov_axis(props, width / height)
            values = {name: float(getattr(self, name)[0]) for name in COEFFICIENTS}
            rho = self.radius(math.radians(fov) / 2, values)
            if given and (np.diff(self.radius(np.linspace(0, math.radians(fov) / 2, 2049), values)) <= 0).any():
                raise props.error("fov", f"can't be {fov:g}: with these coefficients, the picture turns back before")
            reach = {"x": 1.0, "y": height / width, "diagonal": math.hypot(1.0, height / width)}[axis]
            # Half of the film along the axis, in image widths, is rho focal lengths long.
            focal = 0.5 * reach / rho
            self.x_focal, self.y_focal = Float(focal), Float(focal * width / height)
        self.principal_point_offset_x, self.principal_point_offset_y = map(Float, shift)
        self.image_circle = Float(props.float("image_circle", 360.0, low=0.0, high=360.0, low_open=True))
        try:
            self.place()
        except SceneError as error:
            raise SceneError(f"{props.node}: {error}") from None

    # ---- parameters --------------------------------------------------------------------

    def traverse_lens(self, callback: Any) -> None:
        super().traverse_lens(callback)
        callback.put("image_circle", self.image_circle, self.motion_flags("image_circle"))

    def check_parameter(self, name: str, value: Any) -> Any:
        if name not in (*self.lens, "image_circle"):
            return super().check_parameter(name, value)
        number = as_number(dr.detach(value))
        if name == "image_circle" and not 0 < number <= 360:
            raise ParameterError(f"must lie in (0, 360], found {number:g}")
        if name in ("x_focal", "y_focal") and number <= 0:
            raise ParameterError(f"must be greater than 0, found {number:g}")
        if name in COEFFICIENTS and self.projection != "polynomial":
            raise ParameterError(f"has no effect on an {self.projection} projection")
        return Float(value) if dr.grad_enabled(value) else dr.opaque(Float, number)

    # ---- on the host -------------------------------------------------------------------

    def place(self) -> None:
        super().place()
        corner, step = self.window(self.numbers())
        sides = [sorted((corner[k], corner[k] + step[k])) for k in range(2)]
        furthest = math.hypot(*(max(-low, high) for low, high in sides))
        nearest = math.hypot(*(max(low, -high, 0) for low, high in sides))
        theta, rim = self.last_direction()
        if nearest >= rim:
            raise SceneError(
                f"the film shows nothing: it is at least {nearest:.4g} focal lengths from the centre, and the last "
                f"direction of the {self.projection} projection is at {rim:.4g}"
            )
        self.has_image_circle = furthest > rim * (1 + 1e-6)
        self.rim, self.last_theta = as_float(min(rim, 1e9)), as_float(theta)

    def radius(self, theta: Any, values: Mapping[str, Any]) -> Any:
        """The distance from the centre at an angle, in focal lengths, by numbers of the lens: a number, or `Float`."""
        if self.projection == "equisolid":
            return 2 * dr.sin(theta / 2)
        if self.projection == "stereographic":
            return 2 * dr.tan(theta / 2)
        if self.projection == "orthographic":
            return dr.sin(theta)
        if self.projection == "equidistant":
            return theta
        return theta * (1 + sum(values[name] * theta ** (2 * n + 2) for n, name in enumerate(COEFFICIENTS)))

    def last_direction(self) -> tuple[float, float]:
        """The angle of the last direction that is shown, and its distance from the centre."""
        last, values = math.radians(float(dr.detach(self.image_circle)[0])) / 2, self.numbers()
        if self.projection != "polynomial":
            last = min(last, math.radians(LARGEST_FOV[self.projection]) / 2)
            endless = self.projection == "stereographic" and last > math.pi - 1e-6
            return last, math.inf if endless else self.radius(last, values)
        # As far as the polynomial grows.
        theta = np.linspace(0, last, 2049)
        rho = self.radius(theta, values)
        falls = np.flatnonzero(np.diff(rho) <= 0)
        place = falls[0] if len(falls) else -1
        return float(theta[place]), float(rho[place])

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        moved = super().moved_rays(values)
        if self.has_image_circle:
            theta: Any = dr.detach(self.last_theta)
            # Where the projection ends, the circle's angle is beyond the last one; where a polynomial turns, changes
            # of this angle don't matter.
            if "image_circle" in values:
                half = values["image_circle"] * (math.pi / 360)
                theta = dr.select(dr.detach(half) <= theta * (1 + 1e-6), half, theta)
            moved["rim"] = self.radius(theta, {**self.numbers(), **values})
        return moved

    def window(self, values: Mapping[str, Any]) -> tuple[Any, Any]:
        offset, share = self.film_window()
        corner, step = [], []
        for k, axis in enumerate("xy"):
            inverse = 1 / values[f"{axis}_focal"]
            corner.append((0.5 - (values[f"principal_point_offset_{axis}"] + float(offset[k]))) * inverse)
            step.append(-float(share[k]) * inverse)
        return corner, step

    # ---- the map -----------------------------------------------------------------------

    def to_direction(self, q: Point2f) -> Vector3f:
        rho2 = dr.squared_norm(q)
        if self.projection == "equisolid":
            return Vector3f(*(q * dr.safe_sqrt(1 - 0.25 * rho2)), 1 - 0.5 * rho2)
        if self.projection == "stereographic":
            inverse = dr.rcp(1 + 0.25 * rho2)
            return Vector3f(*(q * inverse), (1 - 0.25 * rho2) * inverse)
        if self.projection == "orthographic":
            return Vector3f(q.x, q.y, dr.safe_sqrt(1 - rho2))
        rho = dr.sqrt(dr.maximum(rho2, TINY))
        theta = rho if self.projection == "equidistant" else self.angle(rho)
        sin, cos = dr.sincos(theta)
        return Vector3f(*(q * (sin * dr.rcp(rho))), cos)

    def to_plane(self, d: Vector3f) -> tuple[Point2f, Bool]:
        across = Point2f(d.x, d.y)
        if self.projection == "orthographic":
            return across, d.z > 0
        if self.projection in ("equisolid", "stereographic"):
            ahead = 1 + d.z
            shown = ahead > 1e-6
            inverse = dr.rcp(dr.select(shown, ahead, 1))
            return across * (dr.sqrt(2 * inverse) if self.projection == "equisolid" else 2 * inverse), shown
        sin = dr.sqrt(dr.maximum(dr.squared_norm(across), TINY))
        theta = dr.atan2(sin, d.z)
        if self.projection == "equidistant":
            return across * (theta * dr.rcp(sin)), Bool(True)
        # Beyond its last direction a polynomial may lead back into the picture.
        return across * (self.polynomial(theta)[0] * dr.rcp(sin)), theta <= self.last_theta

    def spread(self, d: Vector3f) -> Float:
        if self.projection == "equisolid":
            return Float(1)
        if self.projection == "stereographic":
            return dr.square(2 * dr.rcp(dr.maximum(1 + d.z, 1e-6)))
        if self.projection == "orthographic":
            return dr.abs(d.z)
        sin = dr.sqrt(dr.maximum(dr.square(d.x) + dr.square(d.y), TINY))
        theta = dr.atan2(sin, d.z)
        if self.projection == "equidistant":
            return theta * dr.rcp(sin)
        rho, slope = self.polynomial(theta)
        return rho * slope * dr.rcp(sin)

    def polynomial(self, theta: Float) -> tuple[Float, Float]:
        """The distance from the centre at an angle, and its derivative."""
        t2 = dr.square(theta)
        k1, k2, k3, k4 = (getattr(self, name) for name in COEFFICIENTS)
        rho = theta * dr.fma(t2, dr.fma(t2, dr.fma(t2, dr.fma(t2, k4, k3), k2), k1), 1)
        slope = dr.fma(t2, dr.fma(t2, dr.fma(t2, dr.fma(t2, 9 * k4, 7 * k3), 5 * k2), 3 * k1), 1)
        return rho, slope

    def angle(self, rho: Float) -> Float:
        """The angle at a distance from the centre, the inverse of `polynomial`.

        Its derivatives, also by the coefficients, are those of one step of Newton's method from the solution.
        """
        with dr.suspend_grad():
            fixed = dr.detach(rho)
            theta = dr.minimum(fixed, math.pi)
            # Near the last direction the polynomial hardly grows.
            for _ in range(2 * STEPS if self.has_image_circle else STEPS):
                theta = dr.clip(self.next_angle(theta, fixed), 0, math.pi)
        theta = dr.detach(theta)
        return self.next_angle(theta, rho)

    def next_angle(self, theta: Float, rho: Float) -> Float:
        """A step of Newton's method towards the angle at a distance from the centre."""
        found, slope = self.polynomial(theta)
        return theta - (found - rho) * dr.rcp(dr.maximum(dr.detach(slope), 1e-3))


TINY = 1e-20
"""Keeps quotients of vanishing lengths at their limit, 1."""

register_sensor("fisheye", Fisheye)
