"""Implicit surfaces: the zeros of a function in space."""

from __future__ import annotations

import drjit as dr
import numpy as np

from djpt.core.numeric import as_array, describe
from djpt.description.plugin import HIDDEN, ParamFlags
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.jit.kernels import as_float, as_vector
from djpt.jit.types import Float, Point3f, Vector3f
from djpt.shapes.axes import AxisPool
from djpt.shapes.level_set import PLACE, LevelSet

__all__ = ["Implicit", "Metaballs"]


class Implicit(LevelSet):
    """All points of a box where a function of your own is 0; it must be negative inside and positive outside.

    Parameters: `function` (takes a `Point3f` in local coordinates, returns a `Float`; written with Dr.Jit's
    operations), `min` and `max` (corners of a box around the surface, local; default (-1, -1, -1) and (1, 1, 1)),
    `lipschitz` (a bound of the length of the function's gradient in the box: 1 for a distance; default 0: unknown),
    `steps` (the diagonal of the box divided by the shortest step; default 4096, or 512 without `lipschitz`),
    `to_world` (affine), `flip_normals`.

    With a bound, rays take steps of abs(f) / `lipschitz` and find every part of the surface that is thicker than a
    step. Without one they take `steps` equal steps: slower. Normals are the gradient, by automatic
    differentiation. Python numbers in the function are constants of the kernel.
    uv = (phi / 2 pi, theta / pi) as seen from the middle of the box. The surface counts as closed, so it should not
    reach the sides of the box.
    """

    in_any_frame = True
    values = dict.fromkeys(PLACE, HIDDEN)
    statics = ("flip_normals", "function")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.function = props.raw("function")
        low, high = props.vector("min", (-1, -1, -1)), props.vector("max", (1, 1, 1))
        if not (low < high).all():
            found = f"{high.tolist()} and {low.tolist()}"
            raise props.error("max", f"must be greater than 'min' in every coordinate, found {found}")
        self.box = (low, high)
        self.slope = props.float("lipschitz", 0.0, low=0.0)
        self.steps = props.integer("steps", 4096 if self.slope > 0 else 512, low=2, high=1_000_000)
        self._try(props)

    def _try(self, props: Properties) -> None:
        """Call the function once, so that its errors are reported here and not while a kernel is traced."""
        if not callable(self.function):
            raise props.error("function", f"must be a function of a Point3f, found {describe(self.function)}")
        p = Point3f([0.1, 0.2], [0.3, -0.1], [0.2, 0.5])
        try:
            value = self.function(p)
        except Exception as error:
            raise props.error("function", f"can't be called with a Point3f: {type(error).__name__}: {error}") from error
        if not isinstance(value, Float) or dr.width(value) not in (1, 2):
            raise props.error("function", f"must return one Float per point, found {describe(value)}")

    def field(self, p: Point3f) -> Float:
        return self.function(p)


class Metaballs(LevelSet):
    """Balls that flow together: the points where sum_i (1 - d_i^2 / r_i^2)^3 = `level`.

    d_i is the distance from ball i; it counts as far as d_i < r_i. Parameters: `balls` (N x 4 numbers: x, y, z and
    r of each), `level` (in (0, 1), default 0.3), `to_world` (affine), `flip_normals`. One ball alone is a sphere of
    radius r sqrt(1 - level^(1/3)). The field falls off as in G. Wyvill, C. McPheeters and B. Wyvill, "Data
    Structure for Soft Objects", The Visual Computer 2, 1986. uv as for `implicit`.
    """

    in_any_frame = True
    statics = ("flip_normals", "count")

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        raw = props.raw("balls")
        with props.naming("balls"):
            balls = as_array(raw)
        if balls.ndim != 2 or balls.shape[1:] != (4,) or len(balls) == 0 or len(balls) > 64:
            raise props.error("balls", f"must be 1 to 64 rows of x, y, z and a radius, found shape {balls.shape}")
        if (balls[:, 3] <= 0).any():
            raise props.error("balls", f"must have positive radii, found {balls[:, 3].min():g}")
        self.count = len(balls)
        self.balls = balls
        self.level = as_float(props.float("level", 0.3, low=0.0, high=1.0, low_open=True, high_open=True))
        names = [f"{what}_{i}" for i in range(self.count) for what in ("at", "inverse")]
        self.values: dict[str, ParamFlags] = dict.fromkeys((*PLACE, "level", *names), HIDDEN)  # type: ignore[misc]
        # The length of each term's gradient is at most 6 (4/5)^2 / sqrt(5) / r.
        self.slope = float((1.7174 / balls[:, 3]).sum())
        self.box = ((balls[:, :3] - balls[:, 3:]).min(axis=0), (balls[:, :3] + balls[:, 3:]).max(axis=0))

    def place(self, pool: AxisPool) -> None:
        for i, (*at, radius) in enumerate(self.balls):
            setattr(self, f"at_{i}", as_vector(np.array(at)))
            setattr(self, f"inverse_{i}", as_float(float(radius) ** -2))
        super().place(pool)

    def field(self, p: Point3f) -> Float:
        total = Float(self.level)
        for i in range(self.count):
            at: Vector3f = getattr(self, f"at_{i}")
            inverse: Float = getattr(self, f"inverse_{i}")
            rest = 1 - dr.squared_norm(p - at) * inverse
            total = total - dr.select(rest > 0, dr.square(rest) * rest, 0)
        return total


register_shape("implicit", Implicit)
register_shape("metaballs", Metaballs)
