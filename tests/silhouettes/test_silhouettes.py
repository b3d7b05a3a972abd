"""Silhouettes of shapes: the same question has the same answer as in Mitsuba."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from tests.kit.axes import unit

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_rgb")  # for names that this file takes while it is imported


@pytest.fixture(autouse=True)
def _variant() -> None:
    """Other tests may have left Mitsuba in another variant."""
    mi.set_variant("llvm_ad_rgb")


TURNED = T().translate([0.1, 0.2, 0.3]).rotate(unit(1, 1, 0), 30).scale(0.8)
SQUARE = T().translate([0.1, 0.2, 0.3]).scale(0.8)
ANALYTIC: dict[str, dict[str, Any]] = {
    "sphere": {"type": "sphere", "to_world": SQUARE},
    # Mitsuba's density of edges is right without a rotation only.
    "rectangle": {"type": "rectangle", "to_world": SQUARE},
    "disk": {"type": "disk", "to_world": TURNED.scale([1, 0.7, 1])},
    "cylinder": {"type": "cylinder", "to_world": TURNED, "p0": [0, 0, -0.7]},
}
VERTICES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 0.5, 0.3], [2, 1.5, 0.3]]
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 4, 5]]
SHAPE_FIELDS = ("p", "n", "uv", "d", "silhouette_d", "prim_index", "projection_index")
FIELDS = (*SHAPE_FIELDS, "pdf", "discontinuity_type", "flags", "foreshortening", "offset")
VIEWPOINT = [3.0, -2.5, 4.0]
PERIMETER, INTERIOR = 1, 2


def numbers(value: Any) -> Any:
    """A Dr.Jit array on the host."""
    return np.atleast_1d(np.array(dr.detach(value)))


def analytic(m: Any, name: str) -> Any:
    description = dict(ANALYTIC[name])
    if m is mi:
        description["to_world"] = mi.ScalarTransform4f(description["to_world"].matrix)
    return m.load_dict(description)


def mesh(m: Any) -> Any:
    """A tetrahedron and a lonely triangle, with gradients: without, meshes have no silhouettes."""
    found = m.Mesh("mesh", len(VERTICES), len(FACES))
    params = m.traverse(found)
    params["vertex_positions"] = m.Float(np.ravel(VERTICES).astype(np.float32))
    params["faces"] = m.UInt32(np.ravel(FACES).astype(np.uint32))
    params.update()
    positions = m.Float(params["vertex_positions"])
    dr.enable_grad(positions)
    params["vertex_positions"] = positions
    params.update()
    return found


def shape(m: Any, name: str) -> Any:
    return mesh(m) if name == "mesh" else analytic(m, name)


def cube(m: Any, n: int = 5) -> Any:
    """Points of the unit cube, off the borders of cells."""
    return m.Point3f(np.random.default_rng(3).random((3, n**3), np.float32) * 0.998 + 0.001)


def same_samples(ours: Any, theirs: Any, but: tuple[str, ...] = (), mesh_edges: bool = False) -> None:
    valid = numbers(theirs.discontinuity_type) > 0
    np.testing.assert_array_equal(numbers(ours.discontinuity_type), numbers(theirs.discontinuity_type))
    for field in FIELDS:
        if field in but:
            continue
        a, b = (numbers(getattr(ss, field)) for ss in (ours, theirs))
        n = max(len(valid), a.shape[-1])
        a, b, kept = (np.broadcast_to(x, (*x.shape[:-1], n)) for x in (a, b, valid))
        a, b = a[..., kept], b[..., kept]
        if field == "d" and mesh_edges:
            # Rounding errors decide which of the two lunes at an edge Mitsuba takes first: half a turn about the edge.
            edge = np.broadcast_to(numbers(ours.silhouette_d), (3, n))[:, kept]
            turned = 2 * edge * (b * edge).sum(axis=0) - b
            b = np.where((a * b).sum(axis=0) < (a * turned).sum(axis=0), turned, b)
        np.testing.assert_allclose(a, b, rtol=2e-4, atol=1e-4, err_msg=field)


def sample_flags(name: str) -> list[int]:
    if name == "mesh":
        return [PERIMETER | 4, PERIMETER | 8]
    return {"sphere": [INTERIOR, PERIMETER], "cylinder": [PERIMETER, INTERIOR]}.get(name, [PERIMETER, INTERIOR])


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", [*ANALYTIC, "mesh"])
def test_samples_are_mitsubas(name: str) -> None:
    ours, theirs = shape(djpt, name), shape(mi, name)
    assert ours.silhouette_discontinuity_types() == theirs.silhouette_discontinuity_types()
    assert ours.silhouette_sampling_weight() == theirs.silhouette_sampling_weight() == 1
    for flags in sample_flags(name):
        a = ours.sample_silhouette(cube(djpt), flags)
        b = theirs.sample_silhouette(cube(mi), flags)
        same_samples(a, b, mesh_edges=name == "mesh")
        valid = numbers(a.is_valid())
        if valid.any():
            back = numbers(ours.invert_silhouette_sample(a))
            valid = np.broadcast_to(valid, back.shape[1:])
            np.testing.assert_allclose(back[:, valid], numbers(cube(djpt))[:, valid], atol=5e-4)
            if name in ("sphere", "disk", "rectangle"):
                assert numbers(ours.ray_test(a.spawn_ray())).mean() < 0.02


@pytest.mark.parametrize("name", [*ANALYTIC, "mesh"])
@pytest.mark.sparse(2)
def test_samples_of_pointers_are_those_of_shapes(name: str) -> None:
    one = shape(djpt, name)
    others = djpt.ShapePtr([one, analytic(djpt, "sphere"), None])
    pointer = dr.gather(djpt.ShapePtr, others, djpt.UInt32(0, 1, 2))
    flags = sample_flags(name)[0]
    point = djpt.Point3f([0.2] * 3, [0.3] * 3, [0.4] * 3)
    alone, chosen = one.sample_silhouette(point, flags), pointer.sample_silhouette(point, flags)
    assert numbers(chosen.p)[:, 0].tolist() == numbers(alone.p)[:, 0].tolist()
    assert numbers(chosen.is_valid()).tolist()[0] and not numbers(chosen.is_valid()).tolist()[2]
    assert numbers(chosen.shape == one).tolist()[0] and not numbers(chosen.shape == one).tolist()[2]
    back = numbers(pointer.invert_silhouette_sample(chosen))
    np.testing.assert_allclose(back[:, 0], [0.2, 0.3, 0.4], atol=1e-4)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", [*ANALYTIC, "mesh"])
def test_projections_are_mitsubas(name: str) -> None:
    uv = np.random.default_rng(5).random((2, 64), np.float32) * 0.98 + 0.01
    u = np.random.default_rng(6).random(64, np.float32)
    found = []
    for m in (djpt, mi):
        one = shape(m, name)
        si = dr.zeros(m.SurfaceInteraction3f, 64)
        si.uv = m.Point2f(uv)
        si.prim_index = m.UInt32(np.arange(64) % len(FACES))
        si.n = one.eval_parameterization(m.Point2f(uv)).n if name == "sphere" else m.Normal3f(0, 0, 1)
        kinds = [PERIMETER, PERIMETER | 16] if name == "mesh" else [PERIMETER, INTERIOR]
        found.append(
            [one.primitive_silhouette_projection(m.Point3f(VIEWPOINT), si, flags, m.Float(u)) for flags in kinds]
        )
    for a, b in zip(*found, strict=True):
        same_samples(a, b, but=("pdf", "foreshortening"))


@pytest.mark.sparse(3)
@pytest.mark.parametrize("name", [*ANALYTIC, "mesh"])
def test_precomputed_silhouettes_are_mitsubas(name: str) -> None:
    u = np.random.default_rng(8).random(60, np.float32) * 0.98 + 0.01
    found = []
    for m in (djpt, mi):
        one = shape(m, name)
        parts, weights = one.precompute_silhouette(m.ScalarPoint3f(VIEWPOINT))
        chosen = dr.gather(m.UInt32, parts, m.UInt32(np.arange(60) % len(parts)))
        ss = one.sample_precomputed_silhouette(m.Point3f(VIEWPOINT), chosen, m.Float(u))
        found.append((ss, numbers(parts), numbers(weights)))
    (a, our_parts, our_weights), (b, their_parts, their_weights) = found
    assert our_parts.tolist() == their_parts.tolist()
    np.testing.assert_allclose(our_weights, their_weights, rtol=1e-5)
    same_samples(a, b, but=("foreshortening", "projection_index"))


def test_edges_of_turned_rectangles_have_the_density_of_their_samples() -> None:
    """1 / (4 length), whichever way the rectangle is turned."""
    one = djpt.load_dict({"type": "rectangle", "to_world": T().rotate([0, 0, 1], 90).scale([2, 0.5, 1])})
    ss = one.sample_precomputed_silhouette(djpt.Point3f(VIEWPOINT), djpt.UInt32(1), djpt.Float(0.1, 0.3, 0.6, 0.9))
    np.testing.assert_allclose(numbers(ss.pdf), [0.25, 0.0625, 0.25, 0.0625], rtol=1e-5)


@pytest.mark.parametrize("name", ANALYTIC)
def test_shapes_move_with_to_world(name: str) -> None:
    grads = []
    for m in (djpt, mi):
        one = analytic(m, name)
        params = m.traverse(one)
        theta = m.Point3f(0.0)
        dr.enable_grad(theta)
        place = m.Transform4f(m.ScalarTransform4f(ANALYTIC[name]["to_world"].matrix))
        if name == "cylinder":
            place = m.Transform4f(params["to_world"])
        params["to_world"] = m.Transform4f().translate([theta.x, 2 * theta.y, 3 * theta.z]) @ place.scale(1 + theta.x)
        params.update()
        assert one.parameters_grad_enabled()
        si = dr.zeros(m.SurfaceInteraction3f)
        si.p, si.uv = m.Point3f(1, 2, 3), m.Point2f(0.3, 0.6)
        p = one.differential_motion(si)
        assert numbers(p).ravel().tolist() == [1, 2, 3]
        dr.forward(theta)
        grads.append(numbers(dr.grad(p)))
    np.testing.assert_allclose(grads[0], grads[1], rtol=1e-4, atol=1e-5)


def test_meshes_move_with_their_vertices() -> None:
    one = mesh(djpt)
    params = djpt.traverse(one)
    theta = djpt.Float(0)
    dr.enable_grad(theta)
    params["vertex_positions"] = dr.detach(params["vertex_positions"]) + theta
    params.update()
    si = dr.zeros(djpt.SurfaceInteraction3f)
    si.prim_index, si.uv = djpt.UInt32(4), djpt.Point2f(0.3, 0.6)
    p = one.differential_motion(si)
    dr.forward(theta)
    np.testing.assert_allclose(numbers(dr.grad(p)).ravel(), [1, 1, 1], rtol=1e-6)
    params["vertex_positions"] = dr.detach(params["vertex_positions"])
    params.update()
    assert not one.parameters_grad_enabled() and not numbers(one.sample_silhouette([0.1] * 3, 5).is_valid()).any()


def scene(m: Any) -> Any:
    """Four shapes, of which a cylinder, a mesh and a sphere move."""
    content = {
        "type": "scene",
        # In the order in which Mitsuba keeps them.
        "b": mesh(m),
        "a": {"type": "cylinder", "to_world": m.ScalarTransform4f(TURNED.matrix), "silhouette_sampling_weight": 2.0},
        "d": {"type": "sphere"},
        "c": {"type": "rectangle"},
    }
    room = m.load_dict(content)
    assert room.silhouette_shapes() == [content["b"]] or m is mi
    params = m.traverse(room)
    for key in ("a.to_world", "d.to_world"):
        theta = m.Float(0)
        dr.enable_grad(theta)
        params[key] = m.Transform4f().translate([theta, 0, 0]) @ m.Transform4f(params[key])
    params.update()
    return room


@pytest.mark.sparse(4)
@pytest.mark.parametrize("flags", [PERIMETER | INTERIOR | 4, PERIMETER | INTERIOR | 8, PERIMETER | 4])
@pytest.mark.slow
def test_silhouettes_of_scenes_are_mitsubas(flags: int) -> None:
    ours, theirs = scene(djpt), scene(mi)
    assert ours.shapes_grad_enabled() and len(ours.silhouette_shapes()) == len(theirs.silhouette_shapes()) == 3
    a, b = ours.sample_silhouette(cube(djpt), flags), theirs.sample_silhouette(cube(mi), flags)
    same_samples(a, b, but=("flags",), mesh_edges=True)
    valid = numbers(b.discontinuity_type) > 0
    assert numbers(a.scene_index)[valid].tolist() == numbers(b.scene_index)[valid].tolist()
    back = numbers(ours.invert_silhouette_sample(a))[:, valid]
    if flags & 3 == 3:
        np.testing.assert_allclose(back, numbers(cube(djpt))[:, valid], atol=3e-4)


def test_scenes_without_gradients_have_no_silhouettes() -> None:
    room = djpt.load_dict({"type": "scene", "a": {"type": "sphere"}})
    assert room.silhouette_shapes() == [] and not room.shapes_grad_enabled()
    assert not numbers(room.sample_silhouette([0.1, 0.2, 0.3], 7).is_valid()).any()


def test_flags_have_mitsubas_values() -> None:
    for name in mi.DiscontinuityFlags.__members__:
        assert int(getattr(djpt.DiscontinuityFlags, name)) == int(getattr(mi.DiscontinuityFlags, name))


def test_shapes_whose_silhouettes_are_not_known() -> None:
    box = djpt.load_dict({"type": "sdfgrid", "grid": djpt.TensorXf([1, 1, 1, 1, -1, 1, 1, 1], (2, 2, 2, 1))})
    assert box.silhouette_discontinuity_types() == 0
    with pytest.raises(SceneError, match="the silhouettes of a 'sdfgrid' aren't known; use a mesh"):
        box.sample_silhouette([0.1, 0.2, 0.3], 1)
    params = djpt.traverse(box)
    assert "to_world" in params
    theta = djpt.Float(0)
    dr.enable_grad(theta)
    with pytest.raises(ParameterError, match="to_world: gradients with respect to this parameter aren't available"):
        params["to_world"] = djpt.Transform4f().translate([theta, 0, 0])


def test_a_record_prints_its_shape() -> None:
    ss = djpt.SilhouetteSample3f()
    assert "shape=[0x0]" in repr(ss) and not numbers(ss.is_valid()).any()
    one = djpt.load_dict({"type": "sphere"})
    ss.assign(one.sample_silhouette([0.1, 0.2, 0.3], INTERIOR))
    assert numbers(ss.shape == djpt.ShapePtr(one)).all() and "shape=[Sphere" in repr(djpt.SilhouetteSample3f(ss))


@pytest.mark.sparse(2)
@pytest.mark.parametrize(
    ("file", "flags"), [("strand.txt", INTERIOR), ("straight.txt", INTERIOR), ("straight.txt", PERIMETER)]
)
def test_samples_of_curves_are_mitsubas(file: str, flags: int) -> None:
    """Of bent curves the ends aren't: they lie across the straight pieces that rays meet."""
    described = {"type": "bsplinecurve", "filename": str(Path(__file__).parent / file)}
    ours, theirs = djpt.load_dict(described), mi.load_dict(described)
    assert ours.silhouette_discontinuity_types() == theirs.silhouette_discontinuity_types()
    a, b = ours.sample_silhouette(cube(djpt), flags), theirs.sample_silhouette(cube(mi), flags)
    # Within, Mitsuba doesn't set the segment, and takes dp/du and dp/dv for perpendicular, as on straight tubes.
    more = ("prim_index", "n", "silhouette_d") if flags == PERIMETER else ()
    more = (*more, "foreshortening") if file == "straight.txt" else more
    for field in ("p", "d", "uv", "pdf", *more):
        found, expected = np.broadcast_arrays(numbers(getattr(a, field)), numbers(getattr(b, field)))
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4, err_msg=field)
    np.testing.assert_allclose(numbers(ours.invert_silhouette_sample(a)), numbers(cube(djpt)), atol=5e-4)
    parts, weights = ours.precompute_silhouette(djpt.ScalarPoint3f(VIEWPOINT))
    expected = theirs.precompute_silhouette(mi.ScalarPoint3f(VIEWPOINT))
    assert [numbers(parts).tolist(), numbers(weights).tolist()] == [numbers(x).tolist() for x in expected]
