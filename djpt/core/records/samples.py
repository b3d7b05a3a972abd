"""Samples: of positions, directions, emitted rays and BSDFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import drjit as dr

from djpt.core.records.interactions import SurfaceInteraction3f
from djpt.core.records.rays import Ray3f
from djpt.core.records.record import Record, SceneRef, latest_scene_ref, of_scene, scene_of
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, UInt32, Vector3f

__all__ = ["BSDFSample3f", "DirectionSample3f", "EmissionSample", "PositionSample3f"]

NO_EMITTER = 0xFFFFFFFF
"""A number that no emitter has."""


class PositionSample3f(Record):
    """A point sampled on a surface: ``PositionSample3f()``, ``PositionSample3f(ps)``, ``PositionSample3f(si)``."""

    title = "PositionSample"

    p: Point3f
    n: Normal3f
    uv: Point2f
    time: Float
    pdf: Float
    """Per unit area."""
    delta: Bool
    """True if the point can't be sampled by chance."""

    def __init__(self, other: Record | None = None, *, si: SurfaceInteraction3f | None = None, **fields: Any) -> None:
        other = other if si is None else si
        if isinstance(other, SurfaceInteraction3f):
            fields = {"p": other.p, "n": other.sh_frame.n, "uv": other.uv, "time": other.time, **fields}
            other = None
        super().__init__(other, **fields)

    @staticmethod
    def of(p: Point3f, n: Normal3f, uv: Point2f, pdf: Float) -> PositionSample3f:
        """The point `p` with its normal and uv, sampled with the density `pdf` per unit area."""
        ps: PositionSample3f = PositionSample3f.holding(p=p, n=n, uv=uv, pdf=pdf)
        return ps


class DirectionSample3f(PositionSample3f):
    """A point on an emitter as seen from a reference point; `pdf` is per unit solid angle there.

    ``DirectionSample3f()``, ``DirectionSample3f(ds)``, ``DirectionSample3f(ps)``, ``DirectionSample3f(scene, si, ref)``
    (the hit `si` as if its emitter had been sampled from `ref`, with the pdf 0), and ``DirectionSample3f(p, n, uv,
    time, pdf, delta, d, dist, emitter)``, also by keywords.

    `weight` is 1 / pdf (0 where pdf is 0). Emitters fill in both, since most of them know both
    without a division.
    """

    title = "DirectionSample"

    d: Vector3f
    """Unit direction from the reference point to `p`."""
    dist: Float
    weight: Float
    emitter_index: UInt32
    """The number of the emitter; the count of emitters, or `NO_EMITTER`, means none."""
    scene_ref: SceneRef

    @overload
    def __init__(self, other: PositionSample3f | None = None, **fields: Any) -> None: ...
    @overload
    def __init__(self, scene: Any, si: SurfaceInteraction3f, ref: Any) -> None: ...
    @overload
    def __init__(
        self, p: Any, n: Any, uv: Any, time: Any, pdf: Any, delta: Any, d: Any, dist: Any, emitter: Any
    ) -> None: ...

    def __init__(self, *values: Any, **fields: Any) -> None:
        if len(values) == 3 or "ref" in fields:
            fields.update(zip(("scene", "si", "ref"), values, strict=False))
            scene, si, ref = (fields.pop(name, None) for name in ("scene", "si", "ref"))
            between = DirectionSample3f.between(ref.p, None, si, scene)
            values, fields = (), {**between.__dict__, **fields}
        elif len(values) > 1:
            fields = dict(zip(ELEMENTS, values, strict=False)) | fields
            values = ()
        # Found first, since it says which scene the emitter belongs to.
        emitter = fields.pop("emitter", None)
        super().__init__(*values, **fields)
        if emitter is not None:
            self.emitter = emitter

    def default(self, name: str) -> Any:
        if name == "scene_ref":
            return {}
        if name == "weight":
            return dr.select(self.pdf > 0, dr.rcp(self.pdf), 0)
        if name == "emitter_index":
            return UInt32(NO_EMITTER)
        return super().default(name)

    def zero_(self, size: int = 1) -> None:
        """Complete `dr.zeros`: no emitter."""
        self.fill_with_zeros(size)
        self.emitter_index, self.scene_ref = dr.full(UInt32, NO_EMITTER, size), latest_scene_ref()

    @staticmethod
    def of(  # type: ignore[override]
        p: Point3f,
        n: Normal3f,
        uv: Point2f,
        d: Vector3f,
        dist: Float,
        pdf: Float,
        weight: Float,
        delta: Bool,
        emitter_index: UInt32,
    ) -> DirectionSample3f:
        """A sample from all that the renderer needs of one."""
        ds: DirectionSample3f = DirectionSample3f.holding(
            p=p, n=n, uv=uv, d=d, dist=dist, pdf=pdf, weight=weight, delta=delta, emitter_index=emitter_index
        )
        return ds

    @staticmethod
    def between(ref: Point3f, ray: Ray3f | None, si: SurfaceInteraction3f, scene: Any = None) -> DirectionSample3f:
        """The hit of a ray described as if its emitter had been sampled from `ref`.

        `ray` started at `ref`, moved off the surface there; None stands for any that hit `si`. `pdf` and `weight` are
        left at 0; `n` is the normal of the side that shines.
        """
        scene = scene or (scene_of(si) if si.scene_ref else None)
        index = UInt32(NO_EMITTER) if scene is None else scene.emitter_index_at(si)
        to_p = si.p - ref
        dist_squared = dr.squared_norm(to_p)
        inv_dist = dr.rsqrt(dist_squared)
        # On a miss the emitter is the environment, known by its direction alone.
        d = dr.select(si.is_valid(), to_p * inv_dist, -si.wi if ray is None else ray.d)
        ds = DirectionSample3f.of(
            si.p, si.sh_frame.n, si.uv, d, dist_squared * inv_dist, Float(0), Float(0), Bool(False), index
        )
        if scene is not None:
            ds.scene_ref = of_scene(scene)
        if "time" in si.__dict__:
            ds.time = si.time
        return ds

    def shown(self) -> Sequence[str]:
        return ELEMENTS

    def text(self, name: str) -> str:
        if name == "emitter" and not self.scene_ref:
            return "[0x0]"
        return super().text(name)

    @property
    def emitter(self) -> Any:
        """The emitter, a `djpt.emitters.pointer.EmitterPtr`; None in a record that belongs to no scene."""
        if "_emitter" in self.__dict__:
            return self.__dict__["_emitter"]
        return scene_of(self).emitter_ptr(self.emitter_index) if self.scene_ref else None

    @emitter.setter
    def emitter(self, emitter: Any) -> None:
        if emitter is None:
            self.emitter_index = UInt32(NO_EMITTER)
        else:
            # Dr.Jit's operations don't carry it along.
            self.__dict__["_emitter"] = emitter
            self.emitter_index = emitter.index


ELEMENTS = ("p", "n", "uv", "time", "pdf", "delta", "d", "dist", "emitter")
"""The arguments of Mitsuba's constructor from elements."""


@dataclass
class EmissionSample:
    """A ray that leaves an emitter, and the two densities that it was drawn with.

        weight = radiance cos / (pdf_position pdf_direction)

    In place of radiance cos, lights at a point have their intensity (W sr^-1), and lights of a single direction
    their power per area (W m^-2). The probability of choosing the emitter isn't included.
    """

    ray: Ray3f
    """From the emitter, without an offset from its surface. `d` has unit length."""
    weight: Color3f
    """Its mean is the emitter's power."""
    n: Normal3f
    """Normal of the side that shines; the ray's direction for light from a point or from infinity."""
    uv: Point2f
    """Texture coordinates at the ray's origin; those of the picture that a light throws or shows; else 0."""
    cos: Float
    """Cosine between the ray and `n`: 1 for light from a point or from infinity."""
    pdf_position: Float
    """Per unit area of the surface; across the ray for light from infinity; 1 for light from a point."""
    pdf_direction: Float
    """Per unit solid angle; 1 for light that leaves each point in one direction only."""
    finite: Bool
    """False for light from infinity: its rays start somewhere outside of the scene."""
    delta: Bool
    """True where position or direction has a delta distribution, whose density is given as 1."""


class BSDFSample3f(Record):
    """A direction sampled from a BSDF; without arguments, a sample without a direction.

    ``BSDFSample3f()``, ``BSDFSample3f(bs)``, ``BSDFSample3f(wo)``, or its fields in order or by keywords.
    """

    title = "BSDFSample3"

    wo: Vector3f
    """Sampled direction in the shading frame."""
    pdf: Float
    """Density per unit solid angle; for a delta lobe the probability of choosing it."""
    eta: Float
    """Relative index of refraction crossed, 1 for reflection."""
    sampled_type: UInt32
    """`BSDFFlags` of the lobe that was sampled."""
    sampled_component: UInt32

    @overload
    def __init__(
        self, wo: Any = None, pdf: Any = None, eta: Any = None, sampled_type: Any = None, sampled_component: Any = None
    ) -> None: ...
    @overload
    def __init__(self, bs: BSDFSample3f) -> None: ...

    def __init__(self, *values: Any, **fields: Any) -> None:
        if "bs" in fields:
            values = (fields.pop("bs"),)
        if values and isinstance(values[0], BSDFSample3f):
            super().__init__(values[0], **fields)
        else:
            super().__init__(None, **dict(zip(self.DRJIT_STRUCT, values, strict=False)), **fields)

    def default(self, name: str) -> Any:
        return Float(1) if name == "eta" else super().default(name)

    @staticmethod
    def of(
        wo: Vector3f,
        pdf: Float | float,
        sampled_type: UInt32 | int,
        *,
        eta: Float | float = 1,
        sampled_component: UInt32 | int = 0,
    ) -> BSDFSample3f:
        """A sample of the lobe `sampled_type` (`BSDFFlags`), from numbers or Dr.Jit arrays."""
        bs: BSDFSample3f = BSDFSample3f.holding(
            wo=wo,
            pdf=Float(pdf),
            eta=Float(eta),
            # Dr.Jit takes flags of several bits for a list of them.
            sampled_type=UInt32(int(sampled_type) if isinstance(sampled_type, int) else sampled_type),
            sampled_component=UInt32(sampled_component),
        )
        return bs

    @staticmethod
    def none() -> BSDFSample3f:
        """A sample without a direction: `wo` and `pdf` are 0."""
        return BSDFSample3f()
