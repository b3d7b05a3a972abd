"""Terms of a path whose values were sampled without gradients, attached to the parameters that move."""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.records import BSDFContext, DirectionSample3f, EmitterFlags, SurfaceInteraction3f, has_flag
from djpt.integrators.projective.weights import solid_angle_to_area_jacobian
from djpt.jit.types import Bool, Color3f, Vector3f

__all__ = ["attached_light", "attached_wi", "bsdf_weight", "direction_to", "relative"]


def relative(value: Any) -> Any:
    """1, with the derivative of log(value); 1 where the value is 0."""
    plain = dr.detach(value)
    ratio: Any = dr.select(plain != 0, value / plain, 1)
    return ratio


def direction_to(si: SurfaceInteraction3f, target: SurfaceInteraction3f, d: Vector3f) -> Vector3f:
    """The direction `d` from one hit to another, attached to the first: the second one stays. `d` on a miss."""
    toward = dr.normalize(dr.detach(target.p) - si.p)
    attached: Any = dr.replace_grad(d, dr.select(target.is_valid(), toward, d))  # type: ignore[func-returns-value]
    return Vector3f(attached)


def attached_wi(si: SurfaceInteraction3f, previous: SurfaceInteraction3f) -> Vector3f:
    """`si.wi`, attached to the point that the ray came from: the hit itself stays."""
    still = dr.detach(si)
    toward = still.sh_frame.to_local(dr.normalize(previous.p - still.p))
    attached: Any = dr.replace_grad(si.wi, dr.select(still.is_valid(), toward, si.wi))  # type: ignore[func-returns-value]
    return Vector3f(attached)


def attached_light(
    scene: Any, si: SurfaceInteraction3f, ds: DirectionSample3f, weight: Color3f, active: Bool
) -> tuple[Vector3f, Color3f]:
    """The direction of an emitter sample and its weight, attached to the emitter's values and to the point `si`.

    The point on the emitter stays; so, as `si` moves, the solid angle of an area changes.
    """
    flags = ds.emitter.flags()
    surface, infinite = has_flag(flags, EmitterFlags.Surface), has_flag(flags, EmitterFlags.Infinite)
    toward = dr.normalize(dr.detach(ds.p) - si.p)
    d: Any = dr.replace_grad(ds.d, dr.select(infinite | ~active, ds.d, toward))  # type: ignore[func-returns-value]
    moved = ds.replaced(d=Vector3f(d))
    arriving = scene.eval_emitter_direction(si, moved, active)
    inverse = dr.select(ds.pdf != 0, dr.rcp(dr.detach(ds.pdf)), 0)
    plain = dr.select(active & dr.any(weight != 0), arriving * inverse, 0)
    attached: Any = dr.replace_grad(weight, plain)  # type: ignore[func-returns-value]
    jacobian = solid_angle_to_area_jacobian(si.p, dr.detach(ds.p), dr.detach(ds.n), active & surface)
    return Vector3f(d), Color3f(attached) * relative(jacobian)


def bsdf_weight(
    bsdf: Any, si: SurfaceInteraction3f, d: Vector3f, target: SurfaceInteraction3f, active: Bool
) -> Color3f:
    """1 per channel, with the relative derivative of a BSDF's value along `d`, times that of the solid angle."""
    value = bsdf.eval(BSDFContext(), si, si.to_local(direction_to(si, target, d)), active)
    jacobian = solid_angle_to_area_jacobian(si.p, dr.detach(target.p), dr.detach(target.n), active & target.is_valid())
    return Color3f(relative(value)) * relative(jacobian)
