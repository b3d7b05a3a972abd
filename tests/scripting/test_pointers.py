"""Pointers: the same questions, asked of a plugin per lane, have the same answers as in Mitsuba."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from tests.scripting.kit import numbers, same

SHAPES: dict[str, Any] = {
    "type": "scene",
    "sensor": {"type": "perspective", "fov": 40, "to_world": T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])},
    "other": {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 4.0, "to_world": T().translate([1, 0, 0])},
    "a": {
        "type": "sphere",
        "radius": 0.9,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1, 2, 3]}},
    },
    "b": {"type": "disk", "to_world": T().translate([0, 0, 0.5])},
    "c": {"type": "cylinder", "radius": 0.8, "flip_normals": True},
    "lamp": {"type": "point", "position": [1, 2, 3]},
}

CALLS = {
    "a shape's rays": "p.ray_intersect(ray).t",
    "a shape's points": "dr.select(p.ray_test(ray), p.ray_intersect(ray).p, 0)",
    "a shape's normals": "dr.select(p.ray_test(ray), p.ray_intersect(ray).n, 0)",
    "the shape of a hit": "p.ray_intersect(ray).shape == p",
    "the BSDF of a hit": "dr.select(p.ray_test(ray), p.ray_intersect(ray).bsdf().flags(), 0)",
    "shadow rays": "p.ray_test(ray)",
    "a hit in two steps": "p.compute_surface_interaction(ray, p.ray_intersect_preliminary(ray)).uv",
    "the hit of a hit in two steps": "p.ray_intersect_preliminary(ray).compute_surface_interaction(ray).p",
    "points by uv": "p.eval_parameterization(m.Point2f(0.3, 0.6)).p",
    "attributes": "p.has_attribute('vertex_x')",
    "sides": "p.has_flipped_normals()",
    "ellipsoids": "p.is_ellipsoids()",
    "sensors of shapes": "p.sensor() == None",
    "media of shapes": "p.interior_medium() == None",
    "densities": "p.pdf_direction(it=it, ps=ds)",
    "shapes of lights": "s.emitters_dr().get_shape() == s.shapes()[0]",
    "points on lights": "s.emitters_dr().sample_position(0.0, m.Point2f(0.2, 0.7))[0].p",
    "media of lights": "s.emitters_dr().get_medium() == None",
    "sensors": "s.sensors_dr() == s.sensors()[1]",
    "camera rays": "s.sensors_dr().sample_ray(0.0, 0.5, m.Point2f(0.3, 0.6), m.Point2f(0.2, 0.4))[0].d",
    "camera rays' origins": "s.sensors_dr().sample_ray(0.0, 0.5, m.Point2f(0.3, 0.6), m.Point2f(0.2, 0.4))[0].o",
    "neighbours of camera rays": "s.sensors_dr().sample_ray_differential(0.0, 0.5, [0.3, 0.6], [0.2, 0.4])[0].d_x",
    "ways to sensors": "s.sensors_dr().sample_direction(it, m.Point2f(0.2, 0.7))[0].d",
    "shapes of sensors": "s.sensors_dr().get_shape() == None",
}


def loaded(m: Any, description: Any) -> Any:
    return djpt.load_dict(description) if m is djpt else m.load_dict(djpt.validation.to_mitsuba(description))


@pytest.mark.sparse(3)
@pytest.mark.parametrize("claim", CALLS)
def test_pointers_answer_as_in_mitsuba(claim: str, mi: Any) -> None:
    found = []
    for m in (djpt, mi):
        s = loaded(m, SHAPES)
        ray = m.Ray3f(m.Point3f(0.1, 0.2, 5), dr.normalize(m.Vector3f(0.05, -0.03, -1)))
        it = dr.zeros(m.Interaction3f)
        it.p = [0.2, 0.1, 4]
        ds = dr.zeros(m.DirectionSample3f, 3)
        ds.p, ds.n, ds.d, ds.dist = [0, 0, 1], [0, 0, 1], [0, 0, -1], 3
        names = {"m": m, "dr": dr, "s": s, "p": s.shapes_dr(), "ray": ray, "it": it, "ds": ds}
        # Symbolic calls ask all shapes that live in this process, and Mitsuba's meshes can't answer: other tests'
        # may not have been collected yet. Evaluated calls ask those of the scene.
        with dr.scoped_set_flag(dr.JitFlag.SymbolicCalls, m is djpt):
            found.append(eval(CALLS[claim], names))
    same(*found, tolerance=2e-5)


MESHES = [
    "p.vertex_count()",
    "p.face_count()",
    "p.has_vertex_normals()",
    "p.has_vertex_texcoords()",
    "p.has_mesh_attributes()",
    "p.face_indices(m.UInt32(0, 1, 0), on)",
    "p.edge_indices(m.UInt32(0, 1, 0), m.UInt32(2, 0, 0), on)",
    "p.vertex_position(m.UInt32(1, 3, 0), on)",
    "p.face_normal(m.UInt32(0, 1, 0), on)",
    "dr.select(on, p.ray_intersect_triangle(m.UInt32(0), ray, on).t, 0)",
    "p.ray_intersect_triangle(m.UInt32(0), ray, on).prim_uv",
]


@pytest.mark.parametrize("call", MESHES)
def test_meshes_answer_per_lane(call: str, mi: Any) -> None:
    """Shapes that have no vertices count as none."""
    found = []
    for m in (djpt, mi):
        one = m.Mesh("one", 3, 1)
        two = m.Mesh("two", 4, 2)
        for mesh, positions, faces in (
            (one, [0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 1, 2]),
            (two, [0, 0, 1, 2, 0, 1, 0, 2, 1, 2, 2, 2], [0, 1, 2, 1, 3, 2]),
        ):
            params = m.traverse(mesh)
            params["vertex_positions"], params["faces"] = m.Float(positions), m.UInt32(faces)
            params.update()
        pick = m.UInt32(0, 1, 2)
        p = dr.select(pick == 0, m.MeshPtr(one), dr.select(pick == 1, m.MeshPtr(two), dr.zeros(m.MeshPtr, 3)))
        ray = m.Ray3f(m.Point3f(0.2, 0.3, 5), m.Vector3f(0, 0, -1))
        found.append(eval(call, {"m": m, "dr": dr, "p": p, "ray": ray, "on": m.Bool(True, True, False)}))
    same(*found, tolerance=1e-6)


def test_other_shapes_are_no_meshes() -> None:
    pointer = djpt.MeshPtr([djpt.load_dict({"type": "sphere"}), djpt.Mesh("m", np.eye(3), [[0, 1, 2]])])
    assert numbers(pointer.is_valid()) == [False, True]
    assert numbers(djpt.MeshPtr(djpt.load_dict({"type": "sphere"})) == None) == [True]  # noqa: E711


def test_textures_per_lane() -> None:
    grey = [djpt.load_dict({"type": "uniform", "value": value}) for value in (5.0, 28.0, 133.0)]
    pointer = dr.zeros(djpt.TexturePtr, 4)
    dr.scatter(pointer, djpt.TexturePtr(grey), djpt.UInt32(0, 2, 3))
    si = dr.zeros(djpt.SurfaceInteraction3f)
    assert numbers(pointer.eval_1(si)) == [5, 0, 28, 133]
    assert numbers(pointer.eval(si).x) == numbers(pointer.max()) == numbers(pointer.mean()) == [5, 0, 28, 133]
    assert not dr.any(pointer.is_spatially_varying())
    assert numbers(pointer.sample_position([0.2, 0.4])[1]) == [1, 0, 1, 1]


def test_a_pointer_to_nothing_evaluates_to_zero() -> None:
    bsdf = djpt.load_dict({"type": "diffuse"})
    pointer = dr.select(djpt.Bool(True, False), djpt.BSDFPtr(bsdf), dr.zeros(djpt.BSDFPtr))
    si = dr.zeros(djpt.SurfaceInteraction3f, 2)
    si.wi = [0, 0, 1]
    value = pointer.eval(djpt.BSDFContext(), si, djpt.Vector3f(0, 0, 1))
    np.testing.assert_allclose(np.array(value.x), [0.5 / np.pi, 0], rtol=1e-6)


def test_values_of_pointers_follow_gradients() -> None:
    """Of the plugins that a script has made a pointer of."""
    bsdf = djpt.load_dict({"type": "diffuse"})
    params = djpt.traverse(bsdf)
    dr.enable_grad(params["reflectance.value"])
    params.update()
    si = dr.zeros(djpt.SurfaceInteraction3f)
    si.wi = [0, 0, 1]
    dr.backward(dr.sum(djpt.BSDFPtr(bsdf).eval(djpt.BSDFContext(), si, djpt.Vector3f(0, 0, 1)).x))
    np.testing.assert_allclose(np.array(dr.grad(params["reflectance.value"]))[:, 0], [1 / np.pi, 0, 0], rtol=1e-6)


def test_equality_outlasts_plugins_that_are_gone() -> None:
    """Numbers of plugins that scripts have thrown away are used again."""
    for _ in range(3):
        a, b = (djpt.load_dict({"type": "sphere"}) for _ in range(2))
        pointer = djpt.ShapePtr([a, b])
        assert numbers(pointer == pointer) == [True, True]
        assert numbers(pointer == a) == [True, False]


def test_attributes_that_no_shape_has() -> None:
    pointer = djpt.ShapePtr(djpt.load_dict({"type": "sphere"}))
    with pytest.raises(SceneError, match="none of the shapes has an attribute 'vertex_x'"):
        pointer.eval_attribute("vertex_x", dr.zeros(djpt.SurfaceInteraction3f))
