"""Scenes, shapes and emitters as scripts ask them: the same question has the same answer as in Mitsuba."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from tests.kit.axes import unit
from tests.scripting.kit import numbers, same

TURNED = T().translate([0.1, 0.2, 0.3]).rotate(unit(1, 1, 0), 30).scale(0.8)

SHAPES: dict[str, dict[str, Any]] = {
    # Mitsuba 3.9.1 doesn't turn the normals of points that are sampled on a turned sphere.
    "sphere": {"type": "sphere", "to_world": T().translate([0.1, 0.2, 0.3]).scale(0.8)},
    "rectangle": {"type": "rectangle", "to_world": TURNED},
    "disk": {"type": "disk", "to_world": TURNED},
    "cylinder": {"type": "cylinder", "to_world": TURNED, "p0": [0, 0, -0.7]},
    "cube": {"type": "cube", "to_world": TURNED},
}

EMITTERS: dict[str, dict[str, Any]] = {
    "point": {"type": "point", "position": [1, 2, 3], "intensity": {"type": "rgb", "value": [1, 2, 3]}},
    "spot": {"type": "spot", "to_world": T().translate([0, 0, -1]), "intensity": 2.0},
    "directional": {"type": "directional", "direction": [0, 0.6, -0.8], "irradiance": 2.0},
    "constant": {"type": "constant", "radiance": 2.0},
}

STRUCTURE = [
    "len(s.shapes())",
    "len(s.emitters())",
    "len(s.sensors())",
    "dr.width(s.shapes_dr())",
    "dr.width(s.emitters_dr())",
    "len(s.sensors_dr())",
    "s.environment() is None",
    "s.integrator() is None",
    "s.shapes_grad_enabled()",
    "s.shapes_dr().is_emitter()",
    "s.shapes_dr().is_mesh()",
    "s.shapes_dr().surface_area()",
    "s.shapes_dr() == s.shapes()[1]",
    "s.shapes_dr() == None",
    "dr.gather(m.ShapePtr, s.shapes_dr(), m.UInt32(2, 0)) == s.shapes()[2]",
    "dr.zeros(m.ShapePtr, 2) == None",
    "s.emitters_dr().flags()",
    "s.emitters_dr().is_environment()",
    "s.emitters_dr().sampling_weight()",
    "dr.select(m.Bool(True, False), m.BSDFPtr(s.shapes()[0].bsdf()), m.BSDFPtr(s.shapes()[1].bsdf())) == "
    "s.shapes()[0].bsdf()",
]


@functools.cache
def scene(m: Any) -> Any:
    # As `optimize=False` for Mitsuba, which would merge the two planes into one mesh.
    description = {
        "type": "scene",
        "ball": {"type": "sphere", "radius": 0.5},
        "floor": {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(3)},
        "lamp": {
            "type": "disk",
            "to_world": T().translate([0, 0, 3]).rotate([1, 0, 0], 180),
            "emitter": {"type": "area"},
        },
        "sky": {"type": "constant", "radiance": 0.5},
        "bulb": {"type": "point", "position": [1, 1, 2]},
    }
    return load(m, description)


KEPT: list[Any] = []
"""What Mitsuba has loaded: it crashes where a scene is gone before its rays are computed."""


def load(m: Any, description: dict[str, Any]) -> Any:
    KEPT.append(loaded(m, description))
    return KEPT[-1]


def loaded(m: Any, description: dict[str, Any]) -> Any:
    return (
        djpt.load_dict(description)
        if m is djpt
        else m.load_dict(djpt.validation.to_mitsuba(description), optimize=False)
    )


@pytest.mark.parametrize("question", STRUCTURE)
def test_what_a_scene_consists_of(question: str, mi: Any) -> None:
    mine, other = (eval(question, {"m": m, "s": scene(m), "dr": dr}) for m in (djpt, mi))
    same(mine, other)


RAYS = "m.Ray3f(m.Point3f([0, 1, 0.2, 5], [0, 0.5, 0.1, 5], 2), m.Vector3f(0, [0, 0, 0.1, 0], -1))"

QUERIES = [
    "s.ray_intersect({r})",
    "s.ray_intersect({r}, m.RayFlags.All, False)",
    "s.ray_intersect({r}, ray_flags=m.RayFlags.Minimal, coherent=True)",
    "s.ray_intersect({r}, m.Bool(True, False, True, True))",
    "s.ray_intersect({r}, active=m.Bool(True, False, True, True))",
    "s.ray_intersect({r}, m.RayFlags.All, m.Bool(True), False, m.UInt32(0), 0, m.Bool(True, False, True, True))",
    "s.ray_intersect_preliminary({r})",
    "s.ray_intersect_preliminary({r}, coherent=True, active=m.Bool(True, False, True, True))",
    "s.ray_intersect_preliminary({r}).compute_surface_interaction({r})",
    "s.ray_intersect_preliminary({r}).compute_surface_interaction({r}, m.RayFlags.UV, m.Bool(True, False, True, True))",
    "s.shapes()[1].ray_intersect({r})",
]


@pytest.mark.sparse(6)
@pytest.mark.parametrize("query", QUERIES)
def test_rays(query: str, mi: Any) -> None:
    found = [eval(query.format(r=RAYS), {"m": m, "s": scene(m)}) for m in (djpt, mi)]
    same(*(pi.is_valid() for pi in found))
    hit = np.array(numbers(found[1].is_valid()))
    assert hit.any()
    minimal = "Minimal" in query or "UV" in query
    names = ("t",) if "preliminary" in query and "compute" not in query else ("t", "p", "n")
    for name in names if minimal or len(names) == 1 else (*names, "wi", "uv", "dp_du"):
        a, b = (np.array(getattr(pi, name), np.float64) for pi in found)
        a, b = (np.broadcast_to(x, (*x.shape[:-1], len(hit)))[..., hit] for x in (a, b))
        np.testing.assert_allclose(a, b, atol=2e-5)


SHADOWS = [
    "s.ray_test({r})",
    "s.ray_test({r}, True)",
    "s.ray_test({r}, m.Bool(True, False, True, True))",
    "s.ray_test({r}, coherent=False)",
    "s.ray_test({r}, False, m.Bool(True, False, True, True))",
    "s.ray_test({r}, coherent=True, active=m.Bool(True, False, True, True))",
]


@pytest.mark.parametrize("call", SHADOWS)
def test_shadow_rays(call: str, mi: Any) -> None:
    same(*(eval(call.format(r=RAYS), {"m": m, "s": scene(m)}) for m in (djpt, mi)))


LIGHTS = [
    "s.sample_emitter(m.Float(0.1, 0.5, 0.9))",
    "[s.pdf_emitter(m.UInt32(1))]",
    "s.sample_emitter_direction(it, m.Point2f([0.1, 0.5, 0.9], 0.4), False)[1:]",
    "s.sample_emitter_direction(it, m.Point2f([0.1, 0.5, 0.9], 0.4), True)[1:]",
    "[s.pdf_emitter_direction(it, s.sample_emitter_direction(it, m.Point2f([0.1, 0.5, 0.9], 0.4), False)[0])]",
    "[s.eval_emitter_direction(it, s.sample_emitter_direction(it, m.Point2f([0.1, 0.5, 0.9], 0.4), False)[0])]",
    "[s.sample_emitter_direction(it, m.Point2f([0.1, 0.5, 0.9], 0.4))[0].emitter.is_environment()]",
    "s.sample_emitter_ray(0, m.Float(0.1, 0.5, 0.9), m.Point2f(0.3, 0.4), m.Point2f(0.6, 0.7), True)[1:2]",
    "[s.sample_emitter_ray(0, m.Float(0.1, 0.5, 0.9), m.Point2f(0.3, 0.4), m.Point2f(0.6, 0.7), True)[0].d]",
]


@pytest.mark.parametrize("question", LIGHTS)
def test_light_sampling(question: str, mi: Any) -> None:
    answers = []
    for m in (djpt, mi):
        it = dr.zeros(m.SurfaceInteraction3f)
        it.p, it.n = [0.2, 0.1, 1], [0, 0, 1]
        answers.append(eval(question, {"m": m, "s": scene(m), "it": it}))
    for mine, other in zip(*answers, strict=True):
        same(mine, other, 1e-4)


SHAPE_QUESTIONS = [
    "s.surface_area()", "s.primitive_count()", "s.effective_primitive_count()", "s.is_mesh()", "s.is_emitter()",
    "s.is_sensor()", "s.is_medium_transition()", "s.bbox().min", "s.bbox().max", "s.interior_medium() is None",
    "s.emitter() is None", "int(s.shape_type())", "s.has_flipped_normals()", "s.parameters_grad_enabled()",
    "s.sample_position(0, u).p", "s.sample_position(0, u).n", "s.sample_position(0, u).pdf",
    "s.pdf_position(s.sample_position(0, u))",
    "s.sample_direction(it, u).d", "s.sample_direction(it, u).pdf", "s.sample_direction(it, u).dist",
    "s.pdf_direction(it, s.sample_direction(it, u))",
    "s.ray_test(r)", "s.ray_intersect(r).t", "s.ray_intersect(r).p", "s.ray_intersect(r).uv",
    "s.ray_intersect_preliminary(r).t", "s.ray_intersect(r).shape == s",
]  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.sparse(4)
def test_shapes_by_themselves(name: str, mi: Any) -> None:
    known = {
        "cube": (
            "sample_direction(it, u).d",
            "sample_position(0, u).p",
            "sample_position(0, u).n",
            "dist",
            "pdf_direction",
        )
    }
    shapes = [load(m, SHAPES[name]) for m in (djpt, mi)]
    for question in SHAPE_QUESTIONS:
        answers = []
        if any(text in question for text in known.get(name, ())) or (
            name in ("cube", "rectangle") and "== s" in question
        ):
            continue  # Mitsuba cuts cubes into triangles and has no rays against single meshes
        if name in ("cube", "rectangle") and "ray_" in question:
            continue
        for m, s in zip((djpt, mi), shapes, strict=True):
            it = m.Interaction3f(0, 0, [], [0.3, 0.2, 5])
            ray = m.Ray3f([0.3, 0.2, 5], [-0.02, 0.01, -1] if name != "cylinder" else [0.1, 0.1, -1])
            answers.append(eval(question, {"m": m, "s": s, "u": [0.3, 0.6], "it": it, "r": ray}))
        try:
            same(*answers, 2e-4)
        except AssertionError as error:
            raise AssertionError(f"{name}: {question}") from error


@pytest.mark.parametrize("name", ["sphere", "rectangle", "disk", "cylinder"])
def test_points_by_texture_coordinates(name: str, mi: Any) -> None:
    mine, other = (load(m, SHAPES[name]).eval_parameterization([0.3, 0.6]) for m in (djpt, mi))
    for field in ("p", "uv", "n"):
        same(getattr(mine, field), getattr(other, field), 1e-4)


def test_points_of_meshes_by_texture_coordinates(mi: Any, tmp_path: Path) -> None:
    """A sheet of four vertices, bent, with a texture that covers a part of the unit square; elsewhere there is none."""
    points = np.array([[0, 0, 0], [2, 0, 1], [0, 3, 1], [2, 3, 0]], np.float32)
    uv = np.array([[0, 0], [1, 0], [0, 0.5], [1, 0.5]], np.float32)
    mesh = djpt.Mesh("sheet", points, np.array([[0, 1, 2], [1, 3, 2]]), texcoords=uv)
    mesh.write_ply(tmp_path / "sheet.ply")
    other = mi.load_dict({"type": "ply", "filename": str(tmp_path / "sheet.ply")})
    wanted = [[0.1, 0.8, 0.5, 0.5], [0.1, 0.4, 0.3, 0.6]]
    mine, theirs = (m.eval_parameterization(k.Point2f(wanted)) for m, k in ((mesh, djpt), (other, mi)))
    assert numbers(mine.is_valid()) == [1, 1, 1, 0] == numbers(theirs.is_valid())
    for field in ("p", "uv", "n"):
        found, expected = (np.array(getattr(si, field))[:, :3] for si in (mine, theirs))
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # The parameterisation follows edits.
    params = djpt.traverse(mesh)
    params["vertex_texcoords"] = djpt.Float(2 * uv.ravel())
    params.update()
    assert numbers(mesh.eval_parameterization(djpt.Point2f(0.5, 0.6)).is_valid()) == [1]
    with pytest.raises(SceneError, match="sheet: the mesh has no texture coordinates"):
        djpt.Mesh("sheet", points, np.array([[0, 1, 2], [1, 3, 2]])).eval_parameterization([0.1, 0.2])


def test_a_cube_has_no_parameterisation() -> None:
    with pytest.raises(SceneError, match="cube: texture coordinates don't determine a point of this shape"):
        djpt.load_dict({"type": "cube"}).eval_parameterization([0.1, 0.2])


def test_a_shape_follows_edits_when_alone() -> None:
    shape = djpt.load_dict({"type": "sphere"})
    assert numbers(shape.ray_intersect(djpt.Ray3f([0, 0, -5], [0, 0, 1])).t) == [4]
    params = djpt.traverse(shape)
    params["to_world"] = T().scale(2)
    params.update()
    assert numbers(shape.ray_intersect(djpt.Ray3f([0, 0, -5], [0, 0, 1])).t) == [3]
    assert np.allclose(numbers(shape.surface_area()), 16 * np.pi) and shape.bbox().max[0] == 2


def test_a_new_bsdf_counts_at_once() -> None:
    """In pointers and in pictures; Mitsuba's `set_bsdf`."""
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=8, height=8)
    scene = djpt.load_dict(box)
    before = np.array(djpt.render(scene, spp=2))
    black = djpt.load_dict({"type": "diffuse", "reflectance": 0.0})
    for shape in scene.shapes():
        shape.set_bsdf(black)
    assert all(numbers(scene.shapes_dr().bsdf() == black))
    after = np.array(djpt.render(scene, spp=2))
    assert after.sum() < 0.5 * before.sum()
    with pytest.raises(TypeError, match="incompatible function arguments"):
        scene.shapes()[0].set_bsdf(None)


EMITTER_QUESTIONS = [
    "int(e.flags())", "e.is_environment()", "e.sampling_weight()", "e.get_shape() is None", "e.get_medium() is None",
    "e.sample_direction(it, [0.3, 0.6])[0].d", "e.sample_direction(it, [0.3, 0.6])[1]",
    "e.pdf_direction(it, e.sample_direction(it, [0.3, 0.6])[0])",
    "e.eval_direction(it, e.sample_direction(it, [0.3, 0.6])[0])",
    "e.sample_ray(2, 0.5, [0.3, 0.6], [0.2, 0.7])[0].o", "e.sample_ray(2, 0.5, [0.3, 0.6], [0.2, 0.7])[0].d",
    "e.sample_ray(2, 0.5, [0.3, 0.6], [0.2, 0.7])[0].time", "e.sample_ray(2, 0.5, [0.3, 0.6], [0.2, 0.7])[1]",
    "e.eval(si)", "e.sample_wavelengths(si, 0.5)[1]",
]  # fmt: skip


@pytest.mark.parametrize("name", EMITTERS)
def test_emitters_by_themselves(name: str, mi: Any) -> None:
    emitters = []
    for m in (djpt, mi):
        emitter = load(m, EMITTERS[name])
        emitter.set_scene(load(m, {"type": "scene", "ball": {"type": "sphere"}}))
        emitters.append(emitter)
    for question in EMITTER_QUESTIONS:
        if "wavelengths" in question and name in ("point", "spot", "directional"):
            continue  # there Mitsuba returns the intensity
        answers = []
        for m, e in zip((djpt, mi), emitters, strict=True):
            si = dr.zeros(m.SurfaceInteraction3f)
            si.p, si.n, si.wi = [0.1, 0.2, 1], [0, 0, 1], [0, 0, 1]
            answers.append(eval(question, {"m": m, "e": e, "it": si, "si": si}))
        try:
            same(*answers, 1e-3)
        except AssertionError as error:
            raise AssertionError(f"{name}: {question}") from error


def test_an_area_light_and_its_shape(mi: Any) -> None:
    for m in (djpt, mi):
        shape = load(m, {"type": "rectangle", "light": {"type": "area", "radiance": 3.0}})
        whole = load(m, {"type": "scene", "lamp": {"type": "rectangle", "light": {"type": "area", "radiance": 3.0}}})
        light = whole.emitters()[0]
        assert shape.is_emitter() and light.get_shape() is not None
        assert whole.shapes()[0].emitter() is light or m is mi
        same(light.bbox().max, [1, 1, 0])
        si = whole.ray_intersect(m.Ray3f([0, 0, 2], [0, 0, -1]))
        same(si.emitter(whole).eval(si), [[3]] * 3)
        same(si.emitter(whole) == light, True)
        ds = m.DirectionSample3f(whole, si, m.Interaction3f(0, 0, [], [0, 0, 2]))
        same(ds.dist, 2)
        same(ds.d, [[0], [0], [-1]])
        same(ds.emitter == light, True)
        # Mitsuba's is rounded by the processor's approximate reciprocals.
        np.testing.assert_allclose(numbers(m.PositionSample3f(si).p), 0, atol=1e-6)


def test_samples_of_hits_by_keywords() -> None:
    room = djpt.load_dict(djpt.cornell_box())
    si = room.ray_intersect(djpt.Ray3f([0, 0, 3], [0, 0.3, -1]))
    ref = djpt.Interaction3f(0, 0, [], [0, 0, 2])
    ours = [
        djpt.DirectionSample3f(room, si, ref),
        djpt.DirectionSample3f(room, si=si, ref=ref),
        djpt.DirectionSample3f(scene=room, si=si, ref=ref),
    ]
    assert len({(str(ds.p), str(ds.d), str(ds.dist)) for ds in ours}) == 1
    assert str(djpt.PositionSample3f(si=si).p) == str(si.p)
