"""Terms of a path whose values were sampled without gradients, attached to the parameters that move.

One rule says how the vertices of a path move, see `docs/theory/moving-geometry.md`: a vertex is the hit of the ray that
arrives at it. That ray stays as it is, unless it comes from a camera that moves, or from a perfectly smooth surface,
which takes it along. What a rough surface looks at stays where it is, in area measure; but a shape that moves takes the
rays along by which it sees itself, see `self_views`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import (
    GRAZING,
    BSDFContext,
    BSDFFlags,
    DirectionSample3f,
    EmitterFlags,
    Ray3f,
    SurfaceInteraction3f,
    has_flag,
)
from djpt.integrators.projective.horizons import horizon_weight
from djpt.integrators.projective.self_views import following, sees_itself
from djpt.integrators.projective.weights import solid_angle_to_area_jacobian
from djpt.jit.types import Bool, Color3f, Float, Normal3f, Point2f, Point3f, Vector3f
from djpt.shapes.silhouettes.base import with_gradient

__all__ = [
    "attached_light",
    "attached_ray",
    "attached_wi",
    "bsdf_weight",
    "delta_lights",
    "has_mirrors",
    "mirrored",
    "relative",
]


def delta_lights(scene: Any) -> list[Any]:
    """The lights of a scene that arrive from one direction at each point."""
    return [e for e in scene.emitters() if has_flag(e.flags(), EmitterFlags.Delta) and not e.on_shape]


def relative(value: Any) -> Any:
    """1, with the derivative of log(value); 1 where the value is 0."""
    plain = dr.detach(value)
    ratio: Any = dr.select(plain != 0, value / plain, 1)
    return ratio


def has_mirrors(scene: Any) -> bool:
    """Whether a surface has a perfectly smooth lobe, or lets light pass straight through."""
    return any(has_flag(bsdf.flags(), BSDFFlags.Delta) for bsdf in scene.bsdfs.ensemble.plugins)


def attached_ray(ray: Ray3f, moving: Ray3f, where: Bool) -> Ray3f:
    """A ray that moves as another one does that is the same, on the lanes `where` it is."""
    o = with_gradient(ray.o, dr.select(where, moving.o, dr.detach(ray.o)))
    d = with_gradient(ray.d, dr.select(where, moving.d, dr.detach(ray.d)))
    return Ray3f(o, d)


def mirrored(wi: Vector3f, wo: Vector3f, eta: Float) -> Vector3f:
    """The direction `wo` of a perfectly smooth lobe, attached to `wi`.

    A reflection turns x and y around; a refraction also divides them by `eta`, the ratio of the indices:

        wo = (-x / eta, -y / eta, +-sqrt(1 - (x^2 + y^2) / eta^2)).
    """
    through = dr.detach(wi.z) * wo.z < 0
    ratio = -dr.select(through, dr.rcp(dr.detach(eta)), 1)
    x, y = wi.x * ratio, wi.y * ratio
    z = dr.mulsign(dr.safe_sqrt(1 - dr.square(x) - dr.square(y)), dr.detach(wo.z))
    return Vector3f(with_gradient(wo, Vector3f(x, y, z)))


def direction_to(si: SurfaceInteraction3f, target: SurfaceInteraction3f, d: Vector3f) -> Vector3f:
    """The direction `d` from one hit to another, attached to the first: the second one stays. `d` on a miss."""
    toward = dr.normalize(dr.detach(target.p) - si.p)
    return Vector3f(with_gradient(d, dr.select(target.is_valid(), toward, d)))


def attached_wi(si: SurfaceInteraction3f, previous: Point3f) -> Vector3f:
    """`si.wi`, attached to the frame of the surface, and to the point that the ray came from; the hit itself stays."""
    still = dr.detach(si)
    toward = si.sh_frame.to_local(dr.normalize(previous - still.p))
    return Vector3f(with_gradient(si.wi, dr.select(still.is_valid(), toward, dr.detach(si.wi))))


def attached_light(
    scene: Any, si: SurfaceInteraction3f, ds: DirectionSample3f, weight: Color3f, free: Bool | bool, active: Bool
) -> tuple[Vector3f, Color3f]:
    """The direction of an emitter sample and its weight, attached to the emitter's values and to the point `si`.

    As with the samples of a BSDF, the place on the emitter is where the ray there hits it: if the emitter moves, its
    texture moves past. As `si` moves, that place stays, and the solid angle of an area changes; but where rays are
    `free` to, they move with a shape that sees itself shine. The light of a point, or parallel light, is followed where
    it goes.
    """
    flags = ds.emitter.flags()
    surface, infinite = has_flag(flags, EmitterFlags.Surface), has_flag(flags, EmitterFlags.Infinite)
    on_lamp = active & surface
    along = Bool(False)
    lamps_move = any(shape.emitter() is not None for _, shape in scene.moving())
    if lamps_move:
        to_lamp = dr.detach(si).spawn_ray(dr.detach(ds.d))
        found = scene.closest_hit(to_lamp, on_lamp)
        along = sees_itself(scene, si.shape_index, found.shape_index, on_lamp & free & found.is_valid())
        hit = scene.surface_interaction_of(found, following(to_lamp, si.p, along))
    toward = dr.normalize(dr.detach(ds.p) - si.p)
    if any(light.is_moving() for light in delta_lights(scene)):
        delta = active & has_flag(flags, EmitterFlags.Delta)
        followed, _ = ds.emitter.sample_direction(si, Point2f(0), delta)
        toward, infinite = dr.select(delta, followed.d, toward), infinite & ~delta
    d = Vector3f(with_gradient(ds.d, dr.select(infinite | along | ~active, dr.detach(ds.d), toward)))
    arriving = scene.eval_emitter_direction(si, ds.replaced(d=d), active)
    if lamps_move:
        hit.wi = dr.select(along, hit.wi, attached_wi(hit, si.p))
        arriving = dr.select(on_lamp & hit.is_valid(), hit.emitter(scene).eval(hit, on_lamp), arriving)
    inverse = dr.select(ds.pdf != 0, dr.rcp(dr.detach(ds.pdf)), 0)
    plain = dr.select(active & dr.any(weight != 0), arriving * inverse, 0)
    change = relative_solid_angle(si.p, ds.p, ds.n, on_lamp & ~along)
    return d, Color3f(with_gradient(weight, plain)) * change * horizon_weight(scene, si, d, ds.dist, active)


def bsdf_weight(
    scene: Any,
    bsdf: Any,
    si: SurfaceInteraction3f,
    d: Vector3f,
    target: SurfaceInteraction3f,
    along: Bool,
    active: Bool,
) -> Color3f:
    """1 per channel, with the relative derivatives of a BSDF's value along `d`, of the solid angle, and of horizons.

    Where the target moves `along`, the direction stays.
    """
    toward = Vector3f(with_gradient(d, dr.select(along, d, direction_to(si, target, d))))
    value = bsdf.eval(BSDFContext(), si, si.to_local(toward), active)
    change = relative_solid_angle(si.p, target.p, target.n, active & target.is_valid() & ~along)
    return Color3f(relative(value)) * change * horizon_weight(scene, si, toward, target.t, active)


def relative_solid_angle(o: Point3f, p: Point3f, n: Normal3f, active: Bool) -> Float:
    """1, with the relative derivative by `o` of the solid angle of an area at `p` whose normal is `n`; both stay.

    It grows without bound where the area is seen at a grazing angle, and below `GRAZING` is left out.
    """
    p, n = dr.detach(p), dr.detach(n)
    d = p - dr.detach(o)
    counts = active & (dr.abs(dr.dot(n, d)) > GRAZING * dr.norm(d))
    return Float(relative(solid_angle_to_area_jacobian(o, p, n, counts)))
