"""Queries of scenes by scripts, with Mitsuba's names and arguments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import drjit as dr

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.frame import Frame3f
from djpt.core.numeric import as_number
from djpt.core.records import (
    GRAZING,
    DirectionSample3f,
    Observer,
    PreliminaryIntersection3f,
    Ray3f,
    RayFlags,
    SurfaceInteraction3f,
)
from djpt.core.records.flags import SurfaceDetail
from djpt.core.records.record import note_latest, of_scene
from djpt.dispatch.ensemble import Ensemble, prepare_followed
from djpt.dispatch.family import NONE, Family
from djpt.emitters import Emitter
from djpt.emitters.pointer import EmitterPtr, observer
from djpt.errors import ArgumentError
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f, converting
from djpt.scene.queries import SceneQueries
from djpt.scene.silhouettes import Silhouettes
from djpt.sensors import Sensor
from djpt.sensors.pointer import SensorPtr
from djpt.shapes import Shape
from djpt.shapes.pointer import ShapePtr
from djpt.shapes.silhouettes.moving import attached_place

if TYPE_CHECKING:
    from djpt.media.pointer import MediumPtr
    from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["MitsubaScene", "distance_on_plane", "distance_to", "is_attached", "make_ends"]


def is_attached(ray: Ray3f) -> bool:
    """Whether hits of the ray depend on anything that is being differentiated."""
    return bool(dr.grad_enabled(ray.o) or dr.grad_enabled(ray.d))


def distance_on_plane(ray: Ray3f, pi: PreliminaryIntersection3f, p: Point3f, n: Vector3f) -> Float:
    """The distance of a hit, differentiable with respect to the ray, from the hit's point and normal (both detached).

    A moved ray meets a surface where, to first order, it meets the tangent plane:

        t = <n, p - o> / <n, d>.

    It stays where the ray grazes the surface, with a cosine below `GRAZING`.
    """
    cosine = dr.dot(n, ray.d)
    grazes = dr.abs(dr.detach(cosine)) < GRAZING * dr.norm(dr.detach(ray.d))
    t = dr.dot(n, p - ray.o) * dr.rcp(dr.select(grazes, 1, cosine))
    return with_derivative(pi, dr.select(grazes, 0, t))


def distance_to(ray: Ray3f, pi: PreliminaryIntersection3f, p: Point3f) -> Float:
    """The distance of a hit, differentiable with respect to the ray, if the point stays: norm(p - o) / norm(d)."""
    return with_derivative(pi, dr.norm(p - ray.o) * dr.rcp(dr.norm(ray.d)))


def with_derivative(pi: PreliminaryIntersection3f, t: Float) -> Float:
    """The distance that was found, with the derivative of `t` where something was hit."""
    found = dr.detach(pi.t)
    attached: Any = dr.replace_grad(found, t)  # type: ignore[func-returns-value]
    return dr.select(found < dr.inf, attached, found)


def make_ends(si: SurfaceInteraction3f) -> None:
    """Give each field of a surface point a node of its own in the graph of derivatives, from which nothing follows.

    uv, for example, is computed from the point, and after a traversal Dr.Jit keeps the derivatives of the graph's ends
    only: that of the point would be lost.
    """
    for name in ("t", "p", "n", "uv", "dp_du", "dp_dv", "wi"):
        si.__dict__[name] = si.__dict__[name] + 0
    frame = si.sh_frame
    si.sh_frame = Frame3f(frame.s + 0, frame.t + 0, frame.n + 0)


class MitsubaScene(SceneQueries):
    """A scene that answers as Mitsuba's: with whole records, which gradients follow."""

    _shapes: list[Shape]
    _sensors: list[Sensor]
    _emitters: list[Emitter]
    _integrator: Any
    differentiated: list[tuple[int, Any]]
    """The shapes whose place has gradients, also where these are suspended, with their indices."""
    silhouettes: Silhouettes
    """The silhouettes of shapes that have gradients."""
    _families: dict[Any, Any]
    """The families of pointers to shapes, made when they are first needed."""

    # ---- contents ----------------------------------------------------------------------

    def sensors(self) -> list[Sensor]:
        """All sensors, in the order of the description."""
        return list(self._sensors)

    def emitters(self) -> list[Emitter]:
        """All emitters in the order in which light sampling numbers them."""
        return list(self._emitters)

    def shapes(self) -> list[Shape]:
        """All shapes, in the order of the description."""
        return list(self._shapes)

    def integrator(self) -> Any:
        """The integrator, or None."""
        return self._integrator

    def environment(self) -> Emitter | None:
        """The emitter that surrounds the scene, or None."""
        return self.lights.environment

    def shapes_dr(self) -> ShapePtr:
        """All shapes, one per lane."""
        return ShapePtr.into(Family(Ensemble(self._shapes), self.lookup), dr.arange(UInt32, len(self._shapes)))

    def emitters_dr(self) -> EmitterPtr:
        """All emitters, one per lane."""
        return self.lights.at(dr.arange(UInt32, len(self._emitters)))

    def sensors_dr(self) -> SensorPtr:
        """All sensors, one per lane."""
        return SensorPtr.into(Family(Ensemble(self._sensors), self.lookup), dr.arange(UInt32, len(self._sensors)))

    def shape_types(self) -> int:
        """The kinds of all shapes, values of `ShapeType`, combined."""
        kinds = 0
        for shape in self._shapes:
            kinds |= int(shape.shape_type())
        return kinds

    def at_time(self, time: float) -> Any:
        """The scene at a time, in which nothing moves: shapes, emitters and sensors are copies, materials are shared.

        Edits of the one don't reach the other, except those of materials and textures.
        """
        from djpt.scene.still import still_scene  # few scenes move

        return still_scene(self, as_number(time))  # type: ignore[arg-type]

    def bbox(self) -> ScalarBoundingBox3f:
        """The box about all shapes, world space; ``low, high = scene.bbox()`` gives its corners."""
        return ScalarBoundingBox3f(*self.geometry.bounding_box())

    # ---- rays ------------------------------------------------------------------------------

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
        surface = self.geometry.surface(near, pi, self.lookup, SurfaceDetail.PARTIALS)
        pi.t = pi.t + entry
        pi.prim_index = self.geometry.primitive_index(pi.face, surface.uv, surface.p, self.lookup)
        pi.prim_uv = dr.select(pi.is_valid(), surface.prim_uv, 0)
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
        record.scene_ref = of_scene(self)
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
        fixed = self.geometry.surface(still, pi, self.lookup, SurfaceDetail.PARTIALS)
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
        return [(i, shape) for i, shape in self.differentiated if attached_place(shape) is not None]

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

    # ---- emitters ----------------------------------------------------------------------------

    def sample_emitter(self, sample: Any, active: Bool | bool = True) -> tuple[UInt32, Float, Float]:
        """Choose an emitter by a uniform number: its number, 1 / probability, and a fresh uniform number."""
        index, inverse, left = self.lights.choice.choose(Point3f(0), None, Float(sample))
        return index, inverse, left

    def pdf_emitter(self, index: Any, active: Bool | bool = True) -> Float:
        """The probability that `sample_emitter` gives the emitter with the number `index`."""
        return self.lights.choice.probability(Point3f(0), None, UInt32(index))

    def sample_emitter_direction(
        self, ref: Observer, sample: Point2f, test_visibility: bool = True, active: Bool | bool = True
    ) -> tuple[DirectionSample3f, Color3f]:
        """Choose an emitter, sample a direction towards it; weight = radiance / pdf.

        `ds.pdf` includes the probability of choosing the emitter. `sample.x` chooses and is then stretched
        for use in the emitter. With `test_visibility` the weight is 0 behind surfaces, and includes absorption.
        """
        light = self.lights.sampling.sample(ref, Point2f(sample), active)
        ds, weight = light.ds, light.weight
        if test_visibility:
            weight = self.transmittance(self.shadow_ray(ref, ds), weight)  # type: ignore[arg-type]
        ds.scene_ref = of_scene(self)
        return ds, weight

    def pdf_emitter_direction(
        self, ref: Observer | Point3f, ds: DirectionSample3f, active: Bool | bool = True
    ) -> Float:
        """The density of `sample_emitter_direction` at `ds`, per unit solid angle at `ref`.

        Of a mere point the normal isn't known: a light sampler that looks at it needs more.
        """
        return self.lights.sampling.pdf(observer(ref), ds, active)

    def eval_emitter_direction(self, ref: Observer, ds: DirectionSample3f, active: Bool | bool = True) -> Color3f:
        """The light from the emitter of `ds` along its direction, without visibility.

        That is the radiance; of a point, intensity / dist^2; of parallel light, the irradiance.
        """
        return self.lights.at(ds.emitter_index).eval_direction(ref, ds, active)

    def sample_emitter_ray(
        self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Bool | bool = True
    ) -> tuple[Ray3f, Color3f, EmitterPtr]:
        """Choose an emitter by `sample1` and sample a ray that leaves it; the weight includes the choice."""
        index, inverse, left = self.sample_emitter(sample1, active)
        emitter = self.lights.at(index)
        ray, weight = emitter.sample_ray(time, left, sample2, sample3, active)
        return ray, weight * dr.select(active, inverse, 0), emitter

    # ---- media -------------------------------------------------------------------------------

    def target_medium(self, si: SurfaceInteraction3f, d: Any, cos_theta: Any = None) -> MediumPtr:
        """The medium that a shape names for the side of `si` that a direction points to; none if it names none.

        The direction `d` is in world space; or one number says its cosine with the normal, as `d` or `cos_theta`.

        Raises:
            ArgumentError: neither or both are given.
        """
        if (d is None) == (cos_theta is None):
            raise ArgumentError("target_medium(): give a direction 'd' or its cosine with the normal, 'cos_theta'")
        d = cos_theta if d is None else d
        direction = si.n * d if dr.depth_v(d) < 2 else Vector3f(d)
        from djpt.media.pointer import MediumPtr  # scenes without media need none

        media = self.every_medium
        pointer: MediumPtr = MediumPtr.into(Family(media.ensemble, self.lookup), media.side(si, direction))
        return pointer

    # ---- silhouettes -------------------------------------------------------------------------

    def silhouette_shapes(self) -> list[Any]:
        """The shapes that have silhouettes: those with gradients and a `silhouette_sampling_weight` above 0."""
        return self.silhouettes.shapes()

    def silhouette_shape(self, number: UInt32) -> ShapePtr:
        """The shapes that `SilhouetteSample3f.scene_index` counts, per lane."""
        return self.silhouettes.shape(number)

    def shapes_grad_enabled(self) -> bool:
        """Whether a parameter that places a shape has gradients."""
        return any(shape.parameters_grad_enabled() for shape in self._shapes)

    @converting
    def sample_silhouette(self, sample: Point3f, flags: int, active: Bool | bool = True) -> SilhouetteSample3f:
        """The segment of a silhouette of any shape that belongs to a point of the unit cube.

        Shapes are chosen by their weights. If `flags` names both kinds of silhouettes, a shape that has both shows each
        with probability 1/2, and a shape that has one shows it.
        """
        return self.silhouettes.sample(sample, flags, active)

    def invert_silhouette_sample(self, ss: SilhouetteSample3f, active: Bool | bool = True) -> Point3f:
        """The point that `sample_silhouette` takes to a segment; `ss.scene_index` tells the shape."""
        return self.silhouettes.invert(ss, active)


NORMAL_PARTIALS = RayFlags.dNGdUV | RayFlags.dNSdUV


def last_mask(reordering: tuple[Any, ...], active: Bool | bool) -> Bool | bool:
    """The lanes that are active: the last of the arguments after `coherent` if it is a mask, or else `active`."""
    last = reordering[-1] if len(reordering) in (1, 4) else active
    return last if isinstance(last, bool) or dr.is_mask_v(last) else active
