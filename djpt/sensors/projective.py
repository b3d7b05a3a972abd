"""What cameras with an image plane share: clip planes, the field of view, the film's place on the plane."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.numeric import as_number
from djpt.core.records import DirectionSample3f, Ray3f
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.sensors.base import Sensor

if TYPE_CHECKING:
    from djpt.description.plugin import Frame

__all__ = ["Central", "ProjectiveCamera", "horizontal_fov"]

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")
FRAME_DIAGONAL = math.hypot(36.0, 24.0)
"""Diagonal of 35 mm film in mm, which `focal_length` refers to."""


class ProjectiveCamera(Sensor):
    """A camera whose rays start on a near plane and end on a far plane.

    Parameters, besides those of all sensors: `near_clip` (0.01) and `far_clip` (10000), measured along
    the optical axis.
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self._near_clip = props.float("near_clip", 1e-2, low=0.0, low_open=True)
        self._far_clip = props.float("far_clip", 1e4, low=0.0, low_open=True)
        if self._near_clip >= self._far_clip:
            raise props.error(
                "near_clip", f"must be less than 'far_clip' ({self._far_clip:g}), found {self._near_clip:g}"
            )

    # ---- parameters --------------------------------------------------------------------

    def traverse(self, callback: TraversalCallback) -> None:
        callback.put("near_clip", self._near_clip, attribute="_near_clip")
        callback.put("far_clip", self._far_clip, attribute="_far_clip")
        super().traverse(callback)
        self.traverse_lens(callback)
        callback.put("to_world", self.placing, self.motion_flags("attached_matrix"))

    def motion_flags(self, name: str) -> ParamFlags:
        """The flags of a parameter that is among the `motions` or not."""
        moves = ParamFlags.Differentiable | ParamFlags.Discontinuous
        return moves if name in self.motions else ParamFlags.NonDifferentiable

    def traverse_lens(self, callback: TraversalCallback) -> None:
        """Report the parameters that the class adds."""

    def check_parameter(self, name: str, value: Any) -> Any:
        checked = super().check_parameter(name, value)
        if name in ("near_clip", "far_clip") and checked <= 0:
            raise ParameterError(f"must be greater than 0, found {checked:g}")
        return checked

    def parameters_changed(self, keys: Sequence[str]) -> None:
        if self._near_clip >= self._far_clip:
            raise ParameterError(
                f"{self.id()}.near_clip: must be less than far_clip ({self._far_clip:g}), found {self._near_clip:g}"
            )
        self.place()

    def move_into(self, frame: Frame) -> None:
        self.move_nested(frame)
        self.to_world = frame.moved_unscaled(self.to_world)
        self._near_clip, self._far_clip = self._near_clip * frame.scale, self._far_clip * frame.scale
        self.move_lens(frame)
        self.place()

    def move_lens(self, frame: Frame) -> None:
        """Convert the lengths that the class adds to those of a working frame."""

    # ---- on the host -------------------------------------------------------------------

    def place(self) -> None:
        """Compute what kernels read."""
        raise NotImplementedError

    def bbox(self) -> ScalarBoundingBox3f:
        """The point where the camera stands, as a box; of one that moves, the box about all such points."""
        p = self.to_world.translation().tolist()
        box = ScalarBoundingBox3f(p, p)
        return box if self.motion is None else self.motion.get_spatial_bounds(box)

    def near_clip(self) -> float:
        """The distance of the near plane along the optical axis."""
        return self._near_clip

    def far_clip(self) -> float:
        """The distance of the far plane along the optical axis."""
        return self._far_clip

    def focus_distance(self) -> float:
        """The entry `focus_distance`, the distance at which the image of a lens is sharp; by default `far_clip`."""
        distance: Any = getattr(self, "_focus_distance", self._far_clip)
        return float(distance[0] if dr.is_array_v(distance) else distance)

    def projection_transform(self) -> Any:
        """The map of camera space to the crop window: see `djpt.sensors.projection_matrices`.

        The shift of a principal point is left out.
        """
        raise NotImplementedError

    def near_clip_fraction(self) -> float:
        return self._near_clip / (self._far_clip - self._near_clip)

    def crop_window(
        self, half_width: float, shift: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The film's place on a plane across the optical axis, in camera space.

        A film position (x, y) in the crop is (u, v) in the whole film and the point
        ((1 - 2u) half_width, (1 - 2v) half_width / aspect) of the plane. Returned are the point of
        (0, 0) and the step from there to (1, 1). `shift` is added to (u, v).
        """
        film = self.film()
        size, crop, offset = (
            np.array(pair, dtype=np.float64) for pair in (film.size(), film.crop_size(), film.crop_offset())
        )
        start = offset / size if shift is None else shift + offset / size
        reach = np.array([half_width, half_width * size[1] / size[0]])
        return (1 - 2 * start) * reach, -2 * reach * crop / size


class Central(ProjectiveCamera):
    """A camera that images by a central projection: the rays through the centre of its lens meet in one point.

    Parameters, besides those of `ProjectiveCamera`: `fov` (degrees, in (0, 180), along `fov_axis`), or
    else `focal_length` (a string such as ``'50mm'``, the default, for 35 mm film); `fov_axis` (`x`,
    the default, `y`, `diagonal`, `smaller` or `larger` of the film's sides). The field of view refers to
    the whole film, also if only a crop of it is rendered.
    """

    values: ClassVar[Mapping[str, ParamFlags]] = dict.fromkeys(
        ("origin", "corner", "across", "down", "near", "depth", "axis", "to_column", "to_row", "inv_area"),
        ParamFlags.NonDifferentiable,
    )
    can_be_reached = True
    is_central = True

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.x_fov = Float(self.field_of_view(props))

    def field_of_view(self, props: Properties) -> float:
        """The field of view along x in degrees, by the entries."""
        width, height = self.film().size()
        return horizontal_fov(props, width / height)

    def check_parameter(self, name: str, value: Any) -> Any:
        if name == "x_fov":
            number = as_number(dr.detach(value))
            if not 0 < number < 180:
                raise ParameterError(f"must lie in (0, 180), found {number:g}")
            return Float(value) if dr.grad_enabled(value) else Float(number)
        return super().check_parameter(name, value)

    def projection_transform(self) -> Any:
        film = self.film()
        window = (film.size(), film.crop_size(), film.crop_offset())
        from djpt.sensors.projection_matrices import perspective_projection  # the renderer needs no such matrix

        return perspective_projection(*window, self.x_fov, self._near_clip, self._far_clip)

    def moved_rays(self, values: Mapping[str, Any]) -> dict[str, Any]:
        from djpt.sensors.moving import central_rays  # images of still cameras need none of it

        return central_rays(self, values)

    def image_shift(self) -> NDArray[np.float64] | None:
        """The shift of the image's centre, in image widths and heights; None if there is none."""
        return None

    def place(self) -> None:
        corner, step = self.crop_window(math.tan(math.radians(dr.detach(self.x_fov)[0]) / 2), self.image_shift())
        linear = self.to_world.matrix[:3, :3]
        self.origin = as_vector(self.to_world.translation())
        self.corner = as_vector(linear @ [*corner, 1.0])
        self.across = as_vector(linear[:, 0] * step[0])
        self.down = as_vector(linear[:, 1] * step[1])
        self.near = as_float(self._near_clip)
        self.depth = as_float(self._far_clip - self._near_clip)
        self.axis = as_vector(linear[:, 2])
        self.to_column, self.to_row = as_vector(linear[:, 0] / step[0]), as_vector(linear[:, 1] / step[1])
        self.inv_area = as_float(1 / abs(step[0] * step[1]))

    def through_centre(self, film_position: Point2f) -> Vector3f:
        """The way of the ray through the centre while it advances by 1 along the optical axis.

        The length of such a vector converts depth to distance.
        """
        return dr.fma(self.across, film_position.x, dr.fma(self.down, film_position.y, self.corner))

    def lens_point(self, aperture_sample: Point2f) -> Vector3f:
        """A point of the lens relative to its centre, in world space."""
        return Vector3f(0)

    def bent(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        """The way of the ray from a point of the lens that has the same image as the ray `m` through the centre.

        Both are per unit along the optical axis.
        """
        return m

    def straightened(self, m: Vector3f, lens: Vector3f) -> Vector3f:
        """The way of the ray through the centre that has the same image as `m`: the inverse of `bent`."""
        return m

    def sample_wi(
        self, ref: Point3f, aperture_sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Float]:
        lens = self.lens_point(aperture_sample)
        start = self.origin + lens
        to_ref = ref - start
        z = dr.dot(to_ref, self.axis)
        in_range = (z > self.near) & (z < self.near + self.depth)
        inv_z = dr.rcp(dr.select(in_range, z, 1))
        # Per unit along the optical axis, as `through_centre`; the inverse of what `ray_through` does.
        m = to_ref * inv_z
        on_plane = self.straightened(m, lens) - self.corner
        uv = Point2f(dr.dot(on_plane, self.to_column), dr.dot(on_plane, self.to_row))
        seen = in_range & (uv.x >= 0) & (uv.x < 1) & (uv.y >= 0) & (uv.y < 1)
        length_squared = dr.squared_norm(m)
        inv_length = dr.rsqrt(length_squared)
        length = length_squared * inv_length
        # dA cos / dist^2 = dw = area of the window on the plane at distance 1 times cos^3.
        importance = length * dr.square(inv_z) * self.inv_area
        ds = DirectionSample3f.of(
            p=dr.fma(m, self.near, start),
            n=self.axis,
            uv=uv,
            d=m * -inv_length,
            dist=(z - self.near) * length,
            pdf=Float(1),
            weight=Float(1),
            delta=Bool(True),
            emitter_index=UInt32(0),
        )
        return ds, dr.select(seen, importance, 0)

    def sample_direction(
        self, it: Any, sample: Point2f, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """See `SampledRays`; `ds.p` is the point of the lens, and `ds.dist` the distance from there."""
        ds, importance = super().sample_direction(it, sample, active)
        behind = self.near * dr.rcp(dr.abs(dr.dot(ds.d, self.axis)))
        ds.p, ds.dist, ds.delta = dr.fma(ds.d, behind, ds.p), ds.dist + behind, Bool(False)
        return ds, importance

    def pdf_ray(self, ray: Ray3f) -> tuple[Float, Float]:
        """The density 1 / (A cos^3), A: the crop window's area on the plane at distance 1; the distance near / cos.

        With a lens, each point of it is the centre of projection of its rays, and the density is the same for all.
        """
        inv_cos = dr.rcp(dr.dot(ray.d, self.axis))
        return self.inv_area * (inv_cos * dr.square(inv_cos)), self.near * inv_cos


def horizontal_fov(props: Properties, aspect: float) -> float:
    """The field of view along x in degrees, from `fov` and `fov_axis` or from `focal_length`.

    `aspect` is width / height of the film.
    """
    if "fov" in props:
        if "focal_length" in props:
            raise props.error("focal_length", "can't be given together with 'fov'")
        fov = props.float("fov", low=0.0, high=180.0, low_open=True, high_open=True)
        axis = fov_axis(props, aspect)
    else:
        if "fov_axis" in props:
            if "focal_length" not in props:
                raise props.error("fov_axis", "needs 'fov'; a focal length refers to the diagonal")
            fov_axis(props, aspect)
            warnings.warn(f"{props.node}: 'fov_axis' has no effect on a focal length", stacklevel=2)
        fov = math.degrees(2 * math.atan(FRAME_DIAGONAL / (2 * focal_length(props))))
        axis = "diagonal"
    t = math.tan(math.radians(fov) / 2)
    if axis == "y":
        t *= aspect
    elif axis == "diagonal":
        t /= math.hypot(1.0, 1.0 / aspect)
    return math.degrees(2 * math.atan(t))


def fov_axis(props: Properties, aspect: float) -> str:
    """The axis that the entry `fov` belongs to: `x`, `y` or `diagonal`."""
    axis = props.string("fov_axis", "x").lower()
    if axis not in FOV_AXES:
        axis = props.string("fov_axis", choices=FOV_AXES)
    if axis == "smaller":
        return "y" if aspect > 1 else "x"
    if axis == "larger":
        return "x" if aspect > 1 else "y"
    return axis


def focal_length(props: Properties) -> float:
    """The entry `focal_length` in millimetres; its unit may be left out."""
    text = props.string("focal_length", "50mm")
    try:
        millimetres = float(text.strip().removesuffix("mm"))
    except ValueError:
        millimetres = math.nan
    if not 0 < millimetres < math.inf:
        raise props.error("focal_length", f"must be a positive length such as '50mm', found '{text}'")
    return millimetres
