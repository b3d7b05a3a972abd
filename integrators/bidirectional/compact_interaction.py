"""Surface points as local memory keeps them, while a path goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from djpt.core.frame import Frame3f
from djpt.core.records import SurfaceInteraction3f
from djpt.core.records.record import Record
from djpt.jit.types import Normal3f, Point2f, Point3f, UInt32, Vector3f

if TYPE_CHECKING:
    from djpt.scene.scene import Scene

__all__ = ["CompactInteraction"]


class CompactInteraction(Record):
    """The fields of a surface point that BSDFs and emitters look at.

    What nobody reads costs nothing: LLVM leaves it out.
    """

    p: Point3f
    n: Normal3f
    sh_frame: Frame3f
    uv: Point2f
    dp_du: Vector3f
    dp_dv: Vector3f
    prim_uv: Point2f
    wi: Vector3f
    face: UInt32
    shape_index: UInt32

    @staticmethod
    def fields_of(si: SurfaceInteraction3f) -> dict[str, Any]:
        """The fields that are kept of a surface point."""
        return {name: getattr(si, name) for name in SURFACE}

    def interaction(self, scene: Scene, media: tuple[UInt32, ...] = ()) -> SurfaceInteraction3f:
        """The surface point, with the medium of the ray that has met it, if that matters."""
        kept = {name: getattr(self, name) for name in SURFACE}
        si: SurfaceInteraction3f = SurfaceInteraction3f.holding(**kept, media=media, scene_ref={scene: ()})
        return si


SURFACE = tuple(CompactInteraction.DRJIT_STRUCT)
