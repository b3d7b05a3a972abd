"""Derivatives by cameras that move: refused with a reason where they would be wrong, and only there."""

from __future__ import annotations

from typing import Any

import drjit as dr
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, RenderError
from djpt.jit.types import Float
from tests.silhouettes.test_unproven import (
    BLOBS,
    INTEGRATORS,
    LAMP,
    NORMALS,
    PLASTER,
    SENSOR,
    VOXELS,
    ball,
    integrator,
    moved,
    room,
)

FOG = {"type": "cube", "to_world": T().scale(20), "bsdf": {"type": "null"}}
"""A box about all, with the camera in it."""


def fog(kind: str = "homogeneous", **medium: Any) -> dict[str, Any]:
    """Fog everywhere."""
    return {**FOG, "interior": {"type": kind, "sigma_t": 0.2, **medium}}


VOXEL_FOG = {"type": "gridvolume", "data": VOXELS[:, :, :, :1], "raw": True, "filter_type": "nearest"}


IN_FOG: dict[str, tuple[dict[str, Any], str]] = {
    "a mirror": ({"moving": ball({"type": "conductor"})}, "what is seen in them"),
    "a mask": ({"moving": ball({"type": "mask", "opacity": 0.5, "nested": PLASTER})}, "what is seen in them"),
    "a normal map": ({"moving": ball({**NORMALS, "bsdf": PLASTER})}, "bent normals"),
    "a glowing medium": ({"fog": fog(emission=0.1)}, "emits light"),
    "voxels": ({"fog": fog("heterogeneous", sigma_t=VOXEL_FOG)}, "edges of their voxels"),
    "a surface of balls": ({"moving": BLOBS}, "may be seen by the camera"),
    "a distorted picture": ({"sensor": {**SENSOR, "k1": 0.1}}, "how much of the film"),
    "a far plane": ({"sensor": {**SENSOR, "far_clip": 7.0}}, "reaches beyond the 'far_clip'"),
}


@pytest.mark.parametrize("name", IN_FOG)
def test_cameras_in_fog_that_are_refused(name: str) -> None:
    nodes, message = IN_FOG[name]
    # The fog reaches further than the far plane.
    scene = with_camera(**{"fog": fog(), **nodes})
    with pytest.raises(RenderError, match=message):
        djpt.render(scene, integrator=djpt.load_dict({"type": "volpath"}), spp=1)
    chosen = djpt.load_dict({"type": "volpath", "max_depth": 2, "unproven_gradients": True})
    assert dr.grad_enabled(djpt.render(scene, integrator=chosen, spp=1))


def test_an_orthographic_camera_under_a_sky() -> None:
    view = {**SENSOR, "type": "orthographic"}
    del view["fov"]
    scene = djpt.load_dict(room(sensor=view, fog=fog(), sky={"type": "constant"}))
    params = djpt.traverse(scene)
    params["sensor.to_world"] = djpt.Transform4f(params["sensor.to_world"]) @ djpt.Transform4f().translate(
        djpt.Vector3f(attached(), 0, 0)
    )
    params.update()
    with pytest.raises(RenderError, match="all its rays show one direction"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "volpath"}), spp=1)


def attached() -> Float:
    """A number with gradients."""
    number = dr.opaque(Float, 0)
    dr.enable_grad(number)
    return number


@pytest.mark.parametrize("kind", ["volpath", "prbvolpath", "volpathmis"])
def test_cameras_in_fog(kind: str) -> None:
    """They have derivatives; if a shape moves as well, the message says that its outlines would be left out."""
    chosen = djpt.load_dict({"type": kind})
    assert dr.grad_enabled(djpt.render(with_camera(fog=fog()), integrator=chosen, spp=1))
    scene, _ = moved(room(fog=fog()))
    with pytest.raises(RenderError, match=r"'moving' moves .* which leave media out: the edges"):
        djpt.render(scene, integrator=chosen, spp=1)


def with_camera(**nodes: Any) -> Any:
    """A scene whose camera moves with gradients."""
    scene = djpt.load_dict(room(**nodes))
    params = djpt.traverse(scene)
    params["sensor.x_fov"] = dr.opaque(Float, 40)
    dr.enable_grad(params["sensor.x_fov"])
    params.update()
    return scene


@pytest.mark.parametrize("kind", INTEGRATORS)
def test_cameras_that_move(kind: str) -> None:
    scene = with_camera()
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator(kind), spp=1))
    box = {**BLOBS, "to_world": T().translate([0, 3, 0])}
    with pytest.raises(RenderError, match=r"'sensor' moves .*'box' .metaballs. may be seen by the camera"):
        djpt.render(with_camera(box=box), integrator=integrator(kind), spp=1)


def test_lamps_that_cut_others_and_a_camera_that_moves() -> None:
    scene = with_camera(other={**LAMP, "to_world": T().scale(3)})
    with pytest.raises(RenderError, match=r"'other' and 'moving' intersect|'moving' and 'other' intersect"):
        djpt.render(scene, integrator=integrator("direct_projective"), spp=1)


@pytest.mark.parametrize(("height", "refused"), [(6.0, False), (-3.0, True)])
def test_the_horizon_of_a_plane(height: float, refused: bool) -> None:
    """It is seen by a camera that looks ahead, and not by one that looks down."""
    place = T().look_at([0, -6, 2], [0, 0, 2 - 0.7 * height], [0, 0, 1])
    scene = djpt.load_dict(room(floor={"type": "plane"}, sensor={**SENSOR, "to_world": place}))
    params = djpt.traverse(scene)
    params["sensor.x_fov"] = dr.opaque(Float, 40)
    dr.enable_grad(params["sensor.x_fov"])
    params.update()
    if refused:
        with pytest.raises(RenderError, match=r"'floor' reaches beyond the 'far_clip' \(10000\)"):
            djpt.render(scene, integrator=integrator(), spp=1)
    else:
        assert dr.grad_enabled(djpt.render(scene, integrator=integrator(), spp=1))


@pytest.mark.parametrize("kind", ["path", "prb", "bdpt", "ptracer", "depth"])
def test_cameras_that_others_cannot_follow(kind: str) -> None:
    with pytest.raises(RenderError, match=r"'sensor' moves with gradients .*'x_fov': render with"):
        djpt.render(with_camera(), integrator=djpt.load_dict({"type": kind}), spp=1)


def test_batches_that_others_cannot_follow() -> None:
    """One of its cameras moves."""
    place = T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 4}
    eyes = {name: {"type": "perspective", "fov": 40, "to_world": place} for name in ("left", "right")}
    scene = djpt.load_dict({**room(), "sensor": {"type": "batch", "film": film, **eyes}})
    params, fov = djpt.traverse(scene), Float(40)
    dr.enable_grad(fov)
    params["sensor.right.x_fov"] = fov
    params.update()
    with pytest.raises(RenderError, match=r"'sensor' moves with gradients .*'x_fov': render with"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "path"}), spp=1)
    assert dr.grad_enabled(djpt.render(scene, integrator=integrator(), spp=1))


def test_cameras_without_derivatives() -> None:
    place = T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    params = djpt.traverse(djpt.load_dict({**room(), "sensor": {"type": "distant", "to_world": place}}))
    assert not params.flags("sensor.to_world").differentiable
    theta = Float(0)
    dr.enable_grad(theta)
    with pytest.raises(DjptError, match="gradients with respect to this parameter aren't available"):
        params["sensor.to_world"] = djpt.Transform4f().translate([theta, 0, 0])
