"""The media of scenes in which bodies overlap: what fills a place follows from the bodies that it is in."""

from __future__ import annotations

import drjit as dr
import numpy as np

from djpt.core.lookup import Numbers, Rows
from djpt.core.records import BSDFFlags, Ray3f, SurfaceInteraction3f, has_flag
from djpt.errors import SceneError
from djpt.geometry.overlapping import OUTSIDE, OverlappingGeometry, bit_of, highest_body
from djpt.jit.kernels import opaque
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f
from djpt.scene.media_placement import DIRECTIONS, Media, points_outward

__all__ = ["OverlappingMedia"]


class OverlappingMedia(Media):
    """Media by the bodies that a ray is in: the one of the highest priority counts.

    What rays carry as their `medium` is a mask here, with the number of the medium outside of all bodies in its lowest
    bits, and above them a bit for each body: see `djpt.geometry.overlapping`.

    Raises:
        SceneError: There are more media than these bits can number, or the index of refraction of a body has gradients.
    """

    _geometry: OverlappingGeometry

    def __bool__(self) -> bool:
        return True

    def prepare(self) -> None:
        super().prepare()
        if self.vacuum > OUTSIDE:
            raise SceneError(f"in scenes with a 'priority' at most {OUTSIDE} media are possible, found {self.vacuum}")
        geometry = self._geometry
        shapes, bodies = geometry.contents.shapes, geometry.bodies
        inside = [self._inside[i] for i in bodies]
        self._filling = Numbers([self.vacuum, *(self.vacuum if n == self._kept else n for n in inside)])
        bsdfs = [shapes[i].bsdf() for i in bodies]
        # What is invisible, such as the boundary of fog, leaves the index of what it is in.
        refracting = [not has_flag(bsdf.flags(), BSDFFlags.Null) for bsdf in bsdfs]
        self._refracting = sum(int(bit_of(UInt32(k + 1))[0]) for k, refracts in enumerate(refracting) if refracts)
        indices = [index_of(bsdf) if refracts else 1.0 for bsdf, refracts in zip(bsdfs, refracting, strict=True)]
        self._indices = Rows([dr.opaque(Float, eta) for eta in (1.0, *indices)])

    def filling(self, medium: UInt32) -> UInt32:
        body = highest_body(medium)
        return dr.select(body == 0, medium & OUTSIDE, self._filling.at(body))

    def index_around(self, si: SurfaceInteraction3f) -> Float | None:
        if si.medium is None:
            return None
        number = self._geometry.number_of_face.at(si.face)
        others = si.medium & ~bit_of(number) & self._refracting
        return dr.select(number == 0, 1, self._indices.at(highest_body(others)))

    def beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32:
        bit = bit_of(self._geometry.number_of_face.at(si.face))
        mask = UInt32(self.vacuum) if si.medium is None else si.medium
        return dr.select(points_outward(si.n, si.sh_frame.n, d), mask & ~bit, mask | bit)

    def along(self, ray: Ray3f, t: Float, active: Bool) -> UInt32:
        assert ray.medium is not None
        return dr.select(active, self._geometry.bodies_at(ray, t, active), ray.medium)

    def at(self, p: Point3f, direction: Vector3f | None = None, outside: UInt32 | None = None) -> UInt32:
        d = Vector3f(*DIRECTIONS[0]) if direction is None else direction
        outside = UInt32(self.vacuum) if outside is None else outside
        return self._geometry.bodies_around(Ray3f(Point3f(p), d)) | outside

    def _majority(self, p: tuple[float, ...]) -> int:
        directions = Vector3f(*(list(c) for c in zip(*DIRECTIONS, strict=True)))
        masks, counts = np.unique(self.at(opaque(Point3f(*p)), directions).numpy(), return_counts=True)
        return int(masks[counts.argmax()])

    def at_sensor(self, given: int, around: int) -> tuple[UInt32, UInt32 | None]:
        return dr.opaque(UInt32, (around & ~OUTSIDE) | given), None


def index_of(bsdf: object) -> float:
    """The index of refraction inside of a surface, relative to that outside."""
    eta = bsdf.eta  # type: ignore[attr-defined]
    if dr.grad_enabled(eta):
        raise SceneError("there are no derivatives with respect to indices of refraction in scenes with a 'priority'")
    return float(eta.numpy()[0])
