"""What scripts ask a shape about its silhouettes, and how it moves with its parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import drjit as dr

from djpt.core.records import SurfaceInteraction3f
from djpt.description.plugin import Plugin
from djpt.errors import SceneError
from djpt.jit.types import Bool, Float, Matrix4f, Point3f, UInt32, converting
from djpt.shapes.silhouettes.moving import attached_place, motion_name, own_place

if TYPE_CHECKING:
    from djpt.shapes.silhouettes.base import Silhouette
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["SilhouetteQuestions"]


class SilhouetteQuestions(Plugin):
    """The part of a shape that projective sampling asks: see `djpt.shapes.silhouettes`.

    All shapes have answers but for linear curves and implicit surfaces, which raise `SceneError`.
    Samples lie in the unit cube. A mesh has silhouettes while its `vertex_positions` have gradients.
    """

    points_parameter: ClassVar[str] = ""
    """The attribute that holds the points in memory that place it: of meshes and curves; else it has a `to_world`."""
    silhouette_weight: float = 1.0

    def silhouette_class(self) -> type[Silhouette] | None:
        """The class of the shape's silhouettes; None (default) if they aren't known. Imported when it is asked for."""
        return None

    def silhouette(self) -> Silhouette:
        """The silhouettes of the shape, as projective sampling asks for them.

        Raises:
            SceneError: They aren't known.
        """
        kind = self.silhouette_class()
        if kind is None:
            found = type(self).__name__.lower()
            raise SceneError(
                f"{self.id()}: the silhouettes of a '{found}' aren't known; use a mesh, or of curves a 'bsplinecurve'"
            )
        return kind(self)

    def _own(self, ss: SilhouetteSample3f) -> SilhouetteSample3f:
        """Make a sample one of this shape."""
        from djpt.shapes.silhouettes.lanes import numbered

        return numbered(ss, [self], UInt32(0))

    def silhouette_discontinuity_types(self) -> int:
        """The `DiscontinuityFlags` of the silhouettes that the shape has; 0 if they aren't known."""
        kind = self.silhouette_class()
        return 0 if kind is None else kind.types

    def silhouette_sampling_weight(self) -> float:
        """The weight with which `Scene.sample_silhouette` chooses the shape, by default 1."""
        return self.silhouette_weight

    @converting
    def sample_silhouette(self, sample: Point3f, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette that belongs to a point of the unit cube; empty if there is none of the kind.

        Args:
            sample: the point.
            flags: `DiscontinuityFlags` of the kinds; for meshes also of the directions.
            active: the lanes that look up vertices.
        """
        if self.is_silent:
            return self._own(no_silhouette())
        return self._own(self.silhouette().sample(sample, int(flags), active))

    def invert_silhouette_sample(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample_silhouette` takes to a segment."""
        return Point3f(0) if self.is_silent else self.silhouette().invert(ss, active)

    @converting
    def primitive_silhouette_projection(
        self, viewpoint: Point3f, si: SurfaceInteraction3f, flags: int, sample: Float, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of the silhouette, as seen from `viewpoint`, that belongs to the surface point `si`.

        `sample` chooses a point of an edge. Density and foreshortening aren't computed.
        """
        if self.is_silent:
            return self._own(no_silhouette())
        return self._own(self.silhouette().project(viewpoint, si, int(flags), sample, active))

    @converting
    def precompute_silhouette(self, viewpoint: Point3f, creases: bool = False) -> tuple[UInt32, Float]:
        """The parts of the silhouette as seen from one point: numbers, and weights to choose among them.

        The parts of meshes and cubes are edges; those of other shapes are `DiscontinuityFlags`. With `creases` edges
        at which shading jumps count even if both of their faces are seen.
        """
        return self.silhouette().precompute(viewpoint, creases)

    @converting
    def sample_precomputed_silhouette(
        self, viewpoint: Point3f, sample1: UInt32, sample2: Float, active: Bool | bool = True
    ) -> SilhouetteSample3f:
        """A point of the part `sample1` of the silhouette, at the fraction `sample2`; `pdf` is per unit length."""
        return self._own(self.silhouette().sample_precomputed(viewpoint, sample1, sample2, active))

    def differential_motion(self, si: SurfaceInteraction3f, active: Bool | bool = True) -> Point3f:
        """The point `si.p`, attached to the parameters of the shape as if it stuck to the surface.

        The place is read from `si.uv`, for meshes barycentric weights, and `si.prim_index`.
        """
        moved = self.silhouette().follow(UInt32(si.prim_index), si.uv, active)
        if moved is None:
            return si.p
        attached: Any = dr.replace_grad(si.p, moved)  # type: ignore[func-returns-value]
        return Point3f(attached)

    @property
    def is_silent(self) -> bool:
        """Whether it has no silhouettes for scripts, as in Mitsuba a mesh that stays."""
        return self.of_triangles and not self.parameters_grad_enabled()  # type: ignore[attr-defined]

    # ---- parameters with gradients --------------------------------------------------------

    @property
    def attached_matrix(self) -> Matrix4f | None:
        """The matrix of `to_world` if it has gradients, else None."""
        lanes = getattr(getattr(self, "to_world", None), "lanes", None)
        return None if lanes is None else lanes.matrix

    def parameters_grad_enabled(self) -> bool:
        """Whether the parameters that place the shape have gradients, also where these are suspended."""
        value = own_place(self)
        if value is None:
            return False
        with dr.resume_grad():
            return bool(dr.grad_enabled(value))

    def is_moving(self) -> bool:
        """Whether the parameters that place the shape have gradients now: not where these are suspended."""
        return attached_place(self) is not None

    def attached_names(self) -> list[str]:
        """The attributes of the shape that have gradients: those that place it, and what it is asked for at hits."""
        return [motion_name(self)] if self.parameters_grad_enabled() else []


def no_silhouette() -> SilhouetteSample3f:
    """An empty sample."""
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f  # rendering needs no silhouettes

    return SilhouetteSample3f()
