"""Small scenes with media."""

from __future__ import annotations

from typing import Any

import djpt
from djpt.core.transforms import ScalarTransform4f as T

__all__ = ["GLASS", "NULL", "colour", "fog", "foggy_room", "lit_ball"]

NULL = {"type": "null"}
GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}


def colour(*rgb: float) -> dict[str, Any]:
    """A colour of a description."""
    return {"type": "rgb", "value": list(rgb)}


def fog(sigma_t: Any = 1.0, albedo: Any = 0.75, **more: Any) -> dict[str, Any]:
    """A homogeneous medium."""
    return {"type": "homogeneous", "sigma_t": sigma_t, "albedo": albedo, **more}


def lit_ball(
    medium: dict[str, Any] | None,
    bsdf: dict[str, Any] = NULL,
    integrator: str = "volpath",
    max_depth: int = -1,
    rr_depth: int = 50,
    size: int = 16,
    **nodes: Any,
) -> dict[str, Any]:
    """A ball of radius 1 that a medium fills, under a white sky."""
    ball: dict[str, Any] = {"type": "sphere", "bsdf": bsdf}
    if medium is not None:
        ball["interior"] = medium
    return {
        "type": "scene",
        "integrator": {"type": integrator, "max_depth": max_depth, "rr_depth": rr_depth},
        "sensor": {
            "type": "perspective",
            "fov": 40,
            "to_world": T().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant", "radiance": 1.0},
        "ball": ball,
        **nodes,
    }


def foggy_room(medium: dict[str, Any], integrator: str = "volpath", around: bool = False, size: int = 16) -> Any:
    """The Cornell box with a cube of a medium in it; `around`: the medium fills all space."""
    scene = djpt.cornell_box()
    scene["integrator"] = {"type": integrator, "max_depth": 8}
    scene["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    if around:
        scene["sensor"]["medium"] = medium
    else:
        scene["fog"] = {"type": "cube", "to_world": T().scale(0.8), "bsdf": NULL, "interior": medium}
    return scene
