"""The silhouettes of shapes as a viewer sees them: curves, sampled by length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr

from djpt.core.records import DiscontinuityFlags, SurfaceInteraction3f
from djpt.distributions.distributions_1d import DiscreteDistribution
from djpt.integrators.projective.guiding import padded
from djpt.integrators.projective.viewpoints import Sight, sampled_from_many
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32
from djpt.shapes.silhouettes.samples import SilhouetteSample3f
from djpt.shapes.silhouettes.seams import Seams, turns_dark

__all__ = ["Outlines"]


class Outlines:
    """The outlines of some shapes.

    Args:
        shapes: the shapes, each of which has silhouettes; `SilhouetteSample3f.scene_index` counts them.
        viewpoint: the point that they are seen from.
        creases: whether edges between two faces that are both seen belong to them.
        with_seams: whether seams of smooth meshes do, if all is seen from one place; None: as creases.
        sight: the place from which each point is seen, if it depends on the point; close to `viewpoint`.
        within: how far from `viewpoint` the places are, if there are many.
    """

    def __init__(
        self,
        shapes: Sequence[Any],
        viewpoint: Any,
        creases: bool = False,
        with_seams: bool | None = None,
        sight: Sight | None = None,
        within: float = 0.0,
    ) -> None:
        self._shapes, self._viewpoint, self._creases, self._sight = shapes, viewpoint, creases, sight
        parts = [
            shape.precompute_silhouette(viewpoint, creases)
            if within == 0
            else shape.silhouette().precompute(viewpoint, creases, within)
            for shape in shapes
        ]
        self._seams: dict[int, tuple[Seams, int]] = {}
        if (creases if with_seams is None else with_seams) and sight is None and within == 0:
            for k, shape in enumerate(shapes):
                if turns_dark(shape):
                    seams, first = Seams(shape.silhouette()), 3 * len(shape.indices)
                    faces, angles = seams.precompute(viewpoint)
                    if dr.width(faces):
                        edges, lengths = parts[k]
                        parts[k] = dr.concat([edges, faces + first]), dr.concat([lengths, angles])
                    self._seams[k] = seams, first
        self._parts = [indices for indices, _ in parts]
        self._within = [
            DiscreteDistribution(padded(weights) if dr.width(weights) else Float(0)) for _, weights in parts
        ]
        seen = [float(dr.width(weights) > 0) for _, weights in parts]
        weights = [s * shape.silhouette_sampling_weight() for s, shape in zip(seen, shapes, strict=True)]
        self._among = DiscreteDistribution(Float(weights)) if any(weights) else None

    def sample(self, sample: Point2f, active: Bool | bool = True, places: Point3f | None = None) -> SilhouetteSample3f:
        """A point of the outlines, with the direction from the viewpoint to it; `pdf` is per unit length.

        Args:
            sample: a random point of the unit square.
            active: the lanes that matter.
            places: where each lane looks from, `within` reach of the viewpoint; None: from there, or by `sight`.
        """
        result = SilhouetteSample3f()
        if self._among is None:
            return result
        number, u, chance = self._among.sample_reuse_pmf(sample.x, active)
        for k, shape in enumerate(self._shapes):
            if not dr.width(self._parts[k]):
                continue
            mine = active & (number == k)
            place, part_chance = self._within[k].sample_pmf(u, mine)
            part = dr.gather(UInt32, self._parts[k], place, mine)
            valid = mine & (part_chance > 0) & (chance > 0)
            if k in self._seams:
                ss = self._on_mesh(shape, k, part, sample.y, valid)
            else:
                ss = self._point(shape, part, sample.y, valid, places)
            ss.pdf, ss.scene_index = ss.pdf * part_chance * chance, UInt32(k)
            result = dr.select(valid, ss, result)
        return result

    def _point(
        self, shape: Any, part: UInt32, along: Float, active: Bool, places: Point3f | None
    ) -> SilhouetteSample3f:
        """A point of a part of an outline."""
        if self._sight is not None:
            ss = sampled_from_many(shape, self._viewpoint, self._sight, part, along, active)
            places = self._sight(ss.p)[0]
        else:
            viewpoint = self._viewpoint if places is None else places
            ss = shape.sample_precomputed_silhouette(viewpoint, part, along, active)
        if places is None:
            return ss
        seen = shape.silhouette().seen(places, part, self._creases)
        ss.discontinuity_type = dr.select(seen, ss.discontinuity_type, 0)
        return ss

    def _on_mesh(self, shape: Any, number: int, part: UInt32, along: Float, active: Bool) -> SilhouetteSample3f:
        """A point of an edge or of a seam, each followed by itself: edges are dark where the surface is."""
        seams, first = self._seams[number]
        on_seam = part >= first
        edge: SilhouetteSample3f = shape.sample_precomputed_silhouette(
            self._viewpoint, dr.select(on_seam, 0, part), along, active & ~on_seam
        )
        edge.unbent = Bool(True)
        return dr.select(on_seam, seams.sample(self._viewpoint, part - first, along, active & on_seam), edge)

    def stops(self, ss: SilhouetteSample3f, active: Bool | bool) -> Bool:
        """Whether rays along `ss.d` meet the surfaces at samples: see `Silhouette.stops`."""
        result = Bool(active)
        for k, shape in enumerate(self._shapes):
            mine = result & (ss.scene_index == k)
            result &= ~mine | shape.silhouette().stops(ss, mine)
        return result

    def follow(self, ss: SilhouetteSample3f, active: Bool | bool = True, viewpoint: Point3f | None = None) -> Point3f:
        """The points of samples, attached to the parameters of the shapes, which they stick to.

        Seams also slide, and as `viewpoint` does, which is attached.
        """
        si = dr.zeros(SurfaceInteraction3f)
        si.p, si.prim_index, si.uv = dr.detach(ss.p), ss.prim_index, ss.uv
        moved = Point3f(si.p)
        for k, shape in enumerate(self._shapes):
            mine = active & (ss.scene_index == k)
            moved = dr.select(mine, shape.differential_motion(si, mine), moved)
            if k in self._seams and viewpoint is not None:
                seam = mine & (ss.discontinuity_type == int(DiscontinuityFlags.InteriorType))
                moved += self._seams[k][0].slide(ss, viewpoint, seam)
        return moved
