"""What scripts ask a scene about rays, with Mitsuba's arguments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import drjit as dr

from djpt.core.records import PreliminaryIntersection3f, Ray3f, RayFlags, SurfaceInteraction3f
from djpt.core.records.scene_ref import note_latest
from djpt.dispatch.ensemble import Ensemble, Lookup
from djpt.dispatch.family import NONE, Family
from djpt.dispatch.followed import prepare_followed
from djpt.geometry.aggregate import Geometry
from djpt.geometry.attached import distance_on_plane, distance_to, is_attached, make_ends
from djpt.jit.types import Bool, Float, UInt32
from djpt.shapes.pointer import ShapePtr
from djpt.shapes.silhouettes.moving import attached_place

__all__ = ["RayQuestions"]


class RayQuestions:
    """The part of a scene that intersects rays for those who want whole records."""

    geometry: Geometry
    lookup: Lookup
    _families: dict[Any, Family[Any]]
    _differentiated: list[tuple[int, Any]]
    """The shapes whose place has gradients, with their indices."""
    is_view = False
    """Whether it is a view of a scene, which rendering has made."""

    def closest_hit(
        self, ray: Ray3f, active: Bool | bool = True, *, through_lights: Bool | None = None
    ) -> PreliminaryIntersection3f:
        """The face that a ray hits first, and the distance."""
        raise NotImplementedError

    def surface_interaction(self, ray: Ray3f, pi: PreliminaryIntersection3f, full: bool = True) -> SurfaceInteraction3f:
        """The surface point of a preliminary intersection."""
        raise NotImplementedError

    def ensembles(self) -> Sequence[Ensemble[Any]]:
        """The plugins whose values a path vertex looks up."""
        raise NotImplementedError

    def ray_intersect_preliminary(
        self,
        ray: Ray3f,
        coherent: Bool | bool = False,
        *reordering: Any,
        active: Bool | bool = True,
        reorder: bool = False,
        reorder_hint: Any = 0,
        reorder_hint_bits: int = 0,
    ) -> PreliminaryIntersection3f:
        """The first hit with 0 < t < maxt, with Mitsuba's fields.

        `coherent`, and what Mitsuba takes to reorder threads, are accepted and change nothing.
        """
        given = dr.detach(ray)
        near, entry = self.geometry.approach(given)
        pi = self.closest_hit(near, last_mask(reordering, active))
        surface = self.geometry.surface(near, pi, self.lookup, full=True)
        pi.t = pi.t + entry
        pi.prim_index = self.geometry.primitive_index(pi.face, surface.uv, surface.p, self.lookup)
        pi.prim_uv = surface.prim_uv
        pi.shape_index = dr.select(pi.is_valid(), pi.shape_index, 0)
        pi.instances = self._instances(pi)
        if pi.near is None or pi.near.inside is None:
            pi.nearby = ()
        self.own(pi)
        return pi

    def ray_intersect(
        self,
        ray: Ray3f,
        ray_flags: int | Bool | bool = RayFlags.All,
        coherent: Bool | bool = False,
        *reordering: Any,
        active: Bool | bool = True,
        reorder: bool = False,
        reorder_hint: Any = 0,
        reorder_hint_bits: int = 0,
    ) -> SurfaceInteraction3f:
        """The first surface point with 0 < t < maxt, with all its fields.

        If the ray carries gradients, so does the point: as the ray moves, it moves on the surface. With
        `RayFlags.FollowShape` it stays, and only its distance changes. A mask as the second argument means `active`, as
        in Mitsuba. `coherent`, and what Mitsuba takes to reorder threads, are accepted and change nothing.
        """
        flags = RayFlags.All
        if isinstance(ray_flags, bool) or dr.is_mask_v(ray_flags):
            active = cast("Bool | bool", ray_flags)
        else:
            flags = RayFlags(int(cast(int, ray_flags)))
        given = dr.detach(ray) if is_attached(ray) else ray
        near, entry = self.geometry.approach(given)
        pi = self.closest_hit(near, last_mask(reordering, active))
        pi.instances = self._instances(pi)
        if given is not ray or self.moving():
            pi.t = pi.t + entry
            return self._attached_interaction(ray, pi, flags)
        si = self.surface_interaction(near, pi)
        si.instances = pi.instances
        si.found_at(si.t + entry, si.is_valid())
        self.own(si)
        if flags & NORMAL_PARTIALS:
            pi.t = si.t
            self._add_normal_partials(si, ray, pi, flags)
        return si

    def ray_test(
        self, ray: Ray3f, *masks: Bool | bool, coherent: Bool | bool = False, active: Bool | bool = True
    ) -> Bool:
        """True where anything is hit with 0 < t < maxt.

        A mask after the ray is `active`, as in Mitsuba; of two the first is `coherent`, which changes nothing.
        """
        lanes = masks[-1] if masks else active
        if len(masks) == 1 and active is not True:
            lanes = active
        return self.geometry.any_hit(self.geometry.approach(dr.detach(ray))[0], lanes)

    def own(self, record: PreliminaryIntersection3f | SurfaceInteraction3f) -> None:
        """Make a record one of this scene, to which also those belong that `dr.zeros` makes from now on."""
        record.home = {self: ()}
        note_latest(self)
        if not self.is_view:
            # A script traces a ray before the loop in which it may want gradients.
            prepare_followed(self.ensembles(), self.lookup)

    def surface_interaction_of(
        self, pi: PreliminaryIntersection3f, ray: Ray3f, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point of a hit of `ray`: see `ray_intersect`."""
        hit = PreliminaryIntersection3f.found(dr.select(active, pi.t, dr.inf), pi.face, pi.shape_index, pi.near)
        hit.instances = pi.instances
        if is_attached(ray) or self.moving():
            return self._attached_interaction(ray, hit, int(ray_flags))
        si = self.surface_interaction(ray, hit)
        si.instances = pi.instances
        self.own(si)
        if ray_flags & NORMAL_PARTIALS:
            self._add_normal_partials(si, ray, hit, ray_flags)
        return si

    def _attached_interaction(self, ray: Ray3f, pi: PreliminaryIntersection3f, flags: int) -> SurfaceInteraction3f:
        """The surface point of a hit, with its derivatives with respect to the ray and by the shapes that move."""
        si = self._on_still_shape(ray, pi, flags) if is_attached(ray) else self.surface_interaction(ray, pi)
        moving = self.moving()
        if moving:
            self.own(si)
            from djpt.shapes.silhouettes.motion import attach  # images of still shapes need none of it

            si = attach(si, ray, flags, moving)
        make_ends(si)
        si.instances = pi.instances
        self.own(si)
        return si

    def _on_still_shape(self, ray: Ray3f, pi: PreliminaryIntersection3f, flags: int) -> SurfaceInteraction3f:
        """The surface point of a hit, with its derivatives with respect to the ray."""
        still = dr.detach(ray)
        fixed = self.geometry.surface(still, pi, self.lookup, full=True)
        if flags & RayFlags.FollowShape:
            si = self.surface_interaction(still, pi)
            si.t = distance_to(ray, pi, dr.detach(fixed.p))
            si.wi = dr.select(si.is_valid(), si.sh_frame.to_local(-ray.d), -ray.d)
        else:
            t = distance_on_plane(ray, pi, dr.detach(fixed.p), dr.detach(fixed.n))
            near = self.geometry.near_again(ray, t, pi.near)
            si = self.surface_interaction(ray, PreliminaryIntersection3f.found(t, pi.face, pi.shape_index, near))
        return si

    def moving(self) -> list[tuple[int, Any]]:
        """The shapes that move with parameters which have gradients here, with their indices."""
        return [(i, shape) for i, shape in self._differentiated if attached_place(shape) is not None]

    def _add_normal_partials(
        self, si: SurfaceInteraction3f, ray: Ray3f, pi: PreliminaryIntersection3f, flags: int
    ) -> None:
        """Set dn/du and dn/dv: the change of the normal where the ray moves along dp/du and dp/dv."""
        changes = []
        for tangent in (si.dp_du, si.dp_dv):
            with dr.resume_grad():
                step = Float(0)
                dr.enable_grad(step)
                moved = self._attached_interaction(Ray3f(ray.o + step * tangent, ray.d), pi, RayFlags.All)
                n = moved.sh_frame.n if flags & RayFlags.dNSdUV else moved.n
                dr.set_grad(step, 1)
                dr.enqueue(dr.ADMode.Forward, step)
                dr.traverse(dr.ADMode.Forward)
                changes.append(dr.select(si.is_valid(), dr.grad(n), 0))
        si.dn_du, si.dn_dv = changes

    def _instances(self, pi: PreliminaryIntersection3f) -> tuple[UInt32, ...]:
        """The instances of hits, for the field of this name."""
        index = self.geometry.instance_of(pi)
        return () if index is None else (index,)

    def instance_at(self, si: SurfaceInteraction3f | PreliminaryIntersection3f) -> ShapePtr:
        """The instance that `si` lies on; none elsewhere."""
        index = si.instances[0] if si.instances else dr.full(UInt32, NONE, dr.width(si.t))
        return ShapePtr.into(self._shape_family(), dr.select(si.is_valid(), index, NONE))

    def _shape_family(self) -> Family[Any]:
        if "shapes" not in self._families:
            self._families["shapes"] = Family(Ensemble(self.geometry.contents.shapes), self.lookup)
        return self._families["shapes"]

    def shape_at(self, si: SurfaceInteraction3f | PreliminaryIntersection3f) -> ShapePtr:
        """The shape at `si`; none on a miss."""
        return ShapePtr.into(self._shape_family(), dr.select(si.is_valid(), si.shape_index, NONE))

    def _family(self, ensemble: Ensemble[Any]) -> Family[Any]:
        """The plugins of an ensemble, for pointers: the same object for each, so that pointers can be compared."""
        key = id(ensemble)
        if key not in self._families:
            self._families[key] = Family(ensemble, self.lookup)
        return self._families[key]


NORMAL_PARTIALS = RayFlags.dNGdUV | RayFlags.dNSdUV


def last_mask(reordering: tuple[Any, ...], active: Bool | bool) -> Bool | bool:
    """The lanes that are active: the last of the arguments after `coherent` if it is a mask, or else `active`."""
    last = reordering[-1] if len(reordering) in (1, 4) else active
    return last if isinstance(last, bool) or dr.is_mask_v(last) else active
