"""The pinhole camera behind a flat window, in water or another medium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import drjit as dr

from djpt.description.plugin import ParamFlags
from djpt.description.properties import Properties
from djpt.jit.kernels import as_float
from djpt.jit.types import Float, Point2f
from djpt.materials.ior import IOR, ior
from djpt.sensors.distorted import DistortedPerspective
from djpt.sensors.perspective import REAL_LENS, Perspective

__all__ = ["ImmersedPerspective"]


class ImmersedPerspective(DistortedPerspective):
    """A `perspective` camera full of air in a denser or thinner medium, seen through its own flat interface.

    Light is refracted where it enters the camera, at a window across the optical axis close to the pinhole. A direction
    at the angle beta to the axis outside is seen at the angle alpha inside, sin(alpha) = eta sin(beta) (Snell), and
    its image is, with r = tan(beta), at the distance

        tan(alpha) = eta r / sqrt(1 - (eta^2 - 1) r^2)

    from the middle, in focal lengths. Near the axis, what is seen is larger by eta. `fov` is the angle within the
    camera. Brightness stays that of the medium: the window's reflection and the factor 1 / eta^2 are left out.

    Parameters, besides those of `perspective`: `ior`, the index of refraction around the camera: a number or a name of
    `djpt.materials.ior.IOR`. As a parameter its quotient by that of air, `eta`. What matter is
    around a point, `djpt.scene.surroundings` finds out; absorption is that of the medium in which the camera is.
    """

    in_any_frame = True
    values: ClassVar[Mapping[str, ParamFlags]] = {
        **{name: flags for name, flags in DistortedPerspective.values.items() if name not in REAL_LENS},
        "eta": ParamFlags.NonDifferentiable,
    }
    lens = ("pixel_aspect", "eta")
    motions = (*Perspective.motions, *lens)
    eta: Float

    def __init__(self, props: Properties) -> None:
        for name in REAL_LENS:
            if name in props:
                raise props.error(name, "can't be given together with 'ior': a lens that distorts has no flat window")
        self.eta = as_float(ior(props, "ior", "air") / IOR["air"])
        super().__init__(props)

    def last_radius(self) -> float:
        """All directions ahead; a thinner medium shows them within the critical angle."""
        return 1e4

    def distorted(self, q: Point2f) -> tuple[Point2f, tuple[Float, Float, Float]]:
        """The place on the image plane of a direction outside, and the derivatives xx, xy and yy."""
        more = dr.square(self.eta) - 1
        # Light beyond the critical angle of a thinner medium doesn't come in: far outside of all pictures.
        root = dr.rsqrt(dr.maximum(1 - more * dr.squared_norm(q), 1e-6))
        radial = self.eta * root
        slope = 0.5 * radial * more * dr.square(root)  # the derivative by r^2
        xx, yy = dr.fma(2 * dr.square(q.x), slope, radial), dr.fma(2 * dr.square(q.y), slope, radial)
        return q * radial, (xx, 2 * q.x * q.y * slope, yy)

    def ideal(self, place: Point2f) -> Point2f:
        """The direction outside of what is seen at a place: the inverse of `distorted`, in closed form."""
        square = dr.square(self.eta)
        return place * dr.rsqrt(dr.maximum(dr.fma(square - 1, dr.squared_norm(place), square), 1e-12))
