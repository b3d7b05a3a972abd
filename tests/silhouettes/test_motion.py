"""Hits on moving shapes: derivatives are those of finite differences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Float

FLOATS = np.random.default_rng(0).normal(size=12).astype(np.float32)
DIRECTION = [0.1, 0.05, -1]
STEP = 4e-3


def pyramid(texcoords: Any = None) -> Any:
    """Three triangles with vertex normals."""
    positions = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0.3], [0.2, 0.1, 1.0]], np.float32)
    found = djpt.Mesh("x", positions, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]]), vertex_texcoords=texcoords)
    found.recompute_vertex_normals()
    return found


def painted_pyramid() -> Any:
    """The same with texture coordinates."""
    return pyramid(np.array([[0.1, 0.2], [0.9, 0.1], [0.4, 0.8], [0.5, 0.3]], np.float32))


def strand() -> dict[str, Any]:
    """Two tubes."""
    return {"type": "bsplinecurve", "filename": str(Path(__file__).parent / "strand.txt")}


SHAPES: dict[str, tuple[Any, str, list[float]]] = {
    "sphere": (lambda: {"type": "sphere"}, "x.to_world", [0.2, 0.3, 3]),
    "rectangle": (lambda: {"type": "rectangle"}, "x.to_world", [0.2, 0.3, 3]),
    "disk": (lambda: {"type": "disk", "flip_normals": True}, "x.to_world", [0.2, 0.3, 3]),
    "cylinder": (lambda: {"type": "cylinder", "p0": [-1, 0, 0], "p1": [1, 0, 0]}, "x.to_world", [0.2, 0.3, 3]),
    "torus": (lambda: {"type": "torus", "minor": 0.4}, "x.to_world", [0.7, 0.3, 3]),
    "cube": (lambda: {"type": "cube"}, "x.vertex_positions", [0.2, 0.3, 3]),
    "cone": (lambda: {"type": "cone"}, "x.to_world", [0.2, 0.3, 3]),
    "paraboloid": (lambda: {"type": "paraboloid", "flip_normals": True}, "x.to_world", [0.2, 0.3, 3]),
    "strand": (strand, "x.control_points", [-0.9, 0.25, 3]),
    "mesh": (pyramid, "x.vertex_positions", [-0.1, -0.4, 3]),
    "painted mesh": (painted_pyramid, "x.vertex_positions", [-0.1, -0.4, 3]),
}


def scene(name: str, theta: Float) -> Any:
    """The shape, moved by `theta`."""
    make, key, _ = SHAPES[name]
    found = djpt.load_dict({"type": "scene", "x": make()})
    params = djpt.traverse(found)
    turn = djpt.Transform4f().translate([theta, 0.5 * theta, -theta]).rotate([1, 0, 0], 10 * theta).scale(1 + theta)
    if name == "cube":
        corners = dr.unravel(djpt.Point3f, Float(params[key]))
        params[key] = dr.ravel(turn.transform_point(corners))
    elif key == "x.control_points":
        params[key] = Float(params[key]) + Float(np.resize(FLOATS, 40) * np.float32([1, 1, 1, 0.2] * 10)) * theta
    elif key == "x.vertex_positions":
        params[key] = Float(params[key]) + Float(FLOATS) * theta
    else:
        params[key] = turn @ djpt.Transform4f(params[key])
    params.update()
    return found


def fields(si: Any) -> dict[str, Any]:
    frame = {"shading normal": si.sh_frame.n, "tangent": si.sh_frame.s, "bitangent": si.sh_frame.t}
    return {"p": si.p, "n": si.n, "t": si.t, "uv": si.uv, "dp_du": si.dp_du, "wi": si.wi, **frame}


@pytest.mark.sparse(2)
@pytest.mark.parametrize("name", SHAPES)
def test_hits_move_with_the_shape(name: str) -> None:
    ray = djpt.Ray3f(SHAPES[name][2], DIRECTION)
    theta = Float(0)
    dr.enable_grad(theta)
    attached = fields(scene(name, theta).ray_intersect(ray))
    dr.forward(theta, dr.ADFlag.ClearEdges)
    still, a, b = (fields(scene(name, Float(x)).ray_intersect(ray)) for x in (0, STEP, -STEP))
    for field, value in attached.items():
        np.testing.assert_allclose(
            np.array(dr.detach(value)), np.array(still[field]), rtol=1e-5, atol=1e-6, err_msg=field
        )
        difference = (np.array(a[field]) - np.array(b[field])) / (2 * STEP)
        np.testing.assert_allclose(np.array(dr.grad(value)), difference, atol=5e-3, rtol=5e-3, err_msg=field)


def test_flags_choose_what_hits_follow() -> None:
    ray = djpt.Ray3f([0.2, 0.3, 3], DIRECTION)
    theta = Float(0)
    dr.enable_grad(theta)
    room = djpt.load_dict({"type": "scene", "x": {"type": "sphere"}})
    params = djpt.traverse(room)
    params["x.to_world"] = djpt.Transform4f().translate([theta, 2 * theta, 3 * theta])
    params.update()
    followed = room.ray_intersect(ray, djpt.RayFlags.All | djpt.RayFlags.FollowShape).p
    detached = room.ray_intersect(ray, djpt.RayFlags.All | djpt.RayFlags.DetachShape).p
    assert not dr.grad_enabled(detached)
    dr.forward(theta)
    np.testing.assert_allclose(np.array(dr.grad(followed)).ravel(), [1, 2, 3], rtol=1e-5)


def test_a_transform_with_gradients_is_lent_with_them() -> None:
    room = scene("sphere", Float(0))
    params = djpt.traverse(room)
    dr.enable_grad(params["x.to_world"])
    params.update()
    assert room.shapes_grad_enabled() and dr.grad_enabled(params["x.to_world"])
    params["x.to_world"] = djpt.ScalarTransform4f()
    params.update()
    assert not room.shapes_grad_enabled()


def test_other_integrators_refuse_moving_shapes() -> None:
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=4, height=4)
    room = djpt.load_dict(box)
    params = djpt.traverse(room)
    theta = Float(0)
    dr.enable_grad(theta)
    params["back.to_world"] = djpt.Transform4f().translate([theta, 0, 0]) @ djpt.Transform4f(params["back.to_world"])
    params.update()
    with pytest.raises(RenderError, match="'back' moves with parameters that have gradients: render with the integr"):
        djpt.render(room, spp=1)
