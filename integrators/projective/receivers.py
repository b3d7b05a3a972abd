"""The points that see silhouettes: surfaces on which shadows fall, and which may move themselves."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import (
    GRAZING,
    SHADOW_EPSILON,
    DirectionSample3f,
    EmitterFlags,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.emitters.area import Area
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.self_views import MOST_FOLLOWED, Approach, sees_itself
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32, Vector3f
from djpt.scene.intersecting_shapes import between, is_sphere
from djpt.shapes.silhouettes.foreground import nothing_at
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["Receiver", "followed", "light_of_lamps", "lit_receivers", "only_lamps_shine", "shadowed_lamps"]

GUIDED = 0.02
"""The cosine below which guides don't follow how fast points slide."""


MOST_LAMPS = 8
"""If there are more lamps, their shadows are left to the paths that begin at silhouettes."""


class Receiver:
    """The points x that see silhouettes at y, whose normal is n: hits of the sensor's rays, or of the next vertex's.

    Args:
        integrator: the integrator, which may hide emitters from the sensor.
        scene: the scene.
        sensor: the sensor.
        ss: the silhouettes.
        place: the places on the film, in pixels.
        edges: the edges between the sensor and the silhouettes.
        approach: the rays that hit the points, where there are more than two edges; None: such points stay.
        active: the lanes that matter.
    """

    def __init__(
        self,
        integrator: Any,
        scene: Any,
        sensor: Any,
        ss: SilhouetteSample3f,
        place: Point2f,
        edges: UInt32,
        approach: Approach | None,
        active: Bool | bool,
    ) -> None:
        window = Point2f(sensor.film().crop_size())
        self._by_sensor = by_sensor = edges == 2
        self._sensor_moves = bool(sensor.attached_names())
        shown = sensor.sample_ray_differential(0, 0, dr.detach(place) / window, Point2f(0))[0]
        ray, seen, self._followed = Ray3f(shown.o, shown.d), Bool(active) & by_sensor, UInt32(0)
        if approach is not None:
            seen, self._followed = Bool(active), approach.count
            ray = approach.last(integrator, scene, ray, seen)
        self._si = integrator.first_hit(scene, ray, seen, by_sensor)
        self._scene, self._ss, self._d = scene, ss, dr.detach(ray.d)
        slides_far = dr.abs(dr.dot(dr.detach(self._si.n), self._d)) < GRAZING
        self._seen = seen & self._si.is_valid() & ~slides_far

    @property
    def p(self) -> Point3f:
        """The points x, attached."""
        return Point3f(self._si.p)

    def sees_itself(self, number: UInt32, active: Bool | bool) -> Bool:
        """Whether what is seen of the shapes of a number moves along with x: see `self_views`."""
        free = active & self._si.is_valid() & (self._followed < MOST_FOLLOWED)
        return sees_itself(self._scene, self._si.shape_index, number, free)

    def speed(self) -> Float:
        """The speed along n of x: 0, attached."""
        x = self._si.p
        return dr.select(self._seen, dr.dot(x - dr.detach(x), dr.detach(self._ss.n)), 0)

    def speed_at_edge(self, behind: Float) -> Float:
        """The speed along n at y of lines from x to fixed points, which are `behind` y at a distance: 0, attached.

        With s the fraction of the way from x to such a point that y lies at, it is (1 - s) <x', n>.
        """
        return self.speed() * rest_of_way(self._distance(), behind)

    def speed_by_turn(self, d: Vector3f, behind: Float) -> Float:
        """The speed along n at y of lines from x to points that move: 0, attached to the direction `d` from y to them.

        They are `behind` y at a distance. As such a point z moves, the line does so by s z' at y, with s the fraction
        of the way from x to z that y lies at; of z' the part across the line counts, which is the distance times d'.
        """
        distance = self._distance()
        speed = dr.dot(d - dr.detach(d), dr.detach(self._ss.n)) * (distance * rest_of_way(distance, behind))
        return dr.select(self._seen, speed, 0)

    def _distance(self) -> Float:
        """The distance between x and y."""
        return dr.norm(dr.detach(self._si.p) - dr.detach(self._ss.p))

    def reach(self) -> Float:
        """How far x slides at most as its shape, or the sensor, moves by 1: the inverse cosine of its ray; else 0."""
        moves = self._by_sensor & self._sensor_moves
        for shape in self._scene.shapes():
            if shape.parameters_grad_enabled():
                moves = moves | (self._si.shape == shape)
        cosine = dr.abs(dr.dot(self._si.n, self._d))
        return dr.select(moves & self._seen, dr.rcp(dr.maximum(cosine, GUIDED)), 0)


def lit_receivers(
    integrator: Any,
    scene: Any,
    sensor: Any,
    sampler: Any,
    ss: SilhouetteSample3f,
    ds: DirectionSample3f,
    arriving: Color3f,
    active: Bool | bool,
) -> tuple[Receiver, Color3f, Point2f, Bool]:
    """The points that see silhouettes in front of a light, where there is one.

    Args:
        integrator: the integrator.
        scene: the scene.
        sensor: the sensor.
        sampler: random numbers for the path from the sensor.
        ss: the silhouettes, which see the light along `ss.d`.
        ds: the light's place and direction from there.
        arriving: E, the light's irradiance there unless something stands in its way.
        active: the lanes that matter.

    Returns:
        The points; W E length(t x d) by the density of samples, not attached, with t the silhouette's tangent, d the
        direction to the light and W the importance that arrives; the places on the film; and the lanes that count.
    """
    with dr.suspend_grad():
        ray = ss.spawn_ray()
        # It starts ahead of a point that isn't exact, or beside it, and ends at the same place.
        ray.d = dr.fma(ss.n, -ss.gap * dr.rcp(ds.dist), ray.d)
        ray.maxt = (ds.dist - dr.dot(ray.o - ss.p, ss.d)) * (1 - SHADOW_EPSILON)
        lit = Bool(active) & dr.any(arriving != 0) & ~scene.ray_test(ray, active) & nothing_at(scene, ss, active)
        importance, place, edges, reached, approach = integrator.sample_viewer(
            scene, sensor, ss, integrator.max_depth, sampler, lit
        )
        lit = lit & reached
        across = dr.norm(dr.cross(ss.d, ss.silhouette_d))
        weight = dr.select(lit, importance * arriving * (across * dr.rcp(ss.pdf)), 0)
        keep(ss, lit, weight, ds.dist, place, edges, approach)
    return Receiver(integrator, scene, sensor, ss, place, edges, approach, lit), Color3f(weight), place, lit


def shadowed_lamps(scene: Any) -> list[Any]:
    """The shapes whose shadows `djpt.integrators.projective.shadows.LampShadows` follows.

    These are lamps that hide no part of themselves, and whose area is known.
    """
    lamps = [shape for shape in scene.geometry.contents.shapes if isinstance(shape.emitter(), Area) and shape.has_area]
    alone = [lamp for lamp in lamps if lamp.plane() is not None or is_sphere(lamp)]
    return alone if len(alone) <= MOST_LAMPS else []


def only_lamps_shine(scene: Any, max_depth: int, direct: bool) -> bool:
    """Whether other surfaces see no silhouettes but those in front of `shadowed_lamps`, or of points.

    Args:
        scene: the scene, with the silhouettes that are followed.
        max_depth: the edges of the longest path.
        direct: whether surfaces are lit by emitters alone.
    """
    lamps = shadowed_lamps(scene)
    outlined = scene.silhouette_shapes()
    return (
        (direct or max_depth <= 2)
        and all(
            has_flag(e.flags(), EmitterFlags.Delta) or any(e is lamp.emitter() for lamp in lamps)
            for e in scene.emitters()
        )
        and not any(shape is lamp for shape in outlined for lamp in lamps)
    )


def light_of_lamps(scene: Any, behind: SurfaceInteraction3f, active: Bool | bool) -> Color3f:
    """The light of `shadowed_lamps` at what is seen behind silhouettes."""
    lamps = shadowed_lamps(scene)
    if not lamps:
        return Color3f(0)
    numbers = [k for k, shape in enumerate(scene.geometry.contents.shapes) if any(shape is lamp for lamp in lamps)]
    return Color3f(behind.emitter(scene).eval(behind, active & is_one_of(behind.shape_index, numbers)))


def rest_of_way(passed: Float, behind: Float) -> Float:
    """The fraction of a way that is left after a part of it; 1 of an infinite one."""
    return dr.select(dr.isfinite(behind), behind / (behind + passed), 1)


def outlined(scene: Any, sensor: Any) -> list[Any]:
    """The shapes whose outlines move on the film: those that move, or, if the sensor does, all."""
    found: list[Any] = scene.silhouettes.outlined() if sensor.attached_names() else scene.silhouette_shapes()
    return found


def followed(scene: Any, sensor: Any, max_depth: int, direct: bool) -> list[Any]:
    """The shapes whose silhouettes matter to other surfaces as some shapes move, or the sensor.

    These are the shapes that move, and those that may hide light from them: what stands in front of a lamp, or, if
    light arrives from all sides, everything. If the sensor moves, its rays hit surfaces elsewhere, in shadows or not.

    Args:
        scene: the scene.
        sensor: the sensor.
        max_depth: the edges of the longest path.
        direct: whether surfaces are lit by emitters alone.
    """
    moving = scene.silhouette_shapes()
    still = [shape for shape in scene.silhouettes.outlined() if shape not in moving]
    emitters = scene.emitters()
    from_all_sides = (
        bool(sensor.attached_names()) or any(e.is_environment() for e in emitters) or not (direct or max_depth <= 2)
    )
    if from_all_sides:
        return [*moving, *still]
    lamps = [e.get_shape() for e in emitters if has_flag(e.flags(), EmitterFlags.Surface) and e.get_shape() is not None]
    return [*moving, *(shape for shape in still if may_shadow(shape, moving, lamps))]


def may_shadow(shape: Any, moving: list[Any], lamps: list[Any]) -> bool:
    """Whether a shape may hide a lamp from one that moves."""
    pairs = ((m, lamp) for m in moving for lamp in lamps if lamp is not m and lamp is not shape)
    return any(between(shape, m.world_box(), lamp.world_box()) for m, lamp in pairs)
