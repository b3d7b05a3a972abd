"""Curves: hits against distances to the curve, uv and partials, open ends, both engines, Mitsuba, instances, edits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.geometry.engines import ray_queries
from djpt.jit.types import Float, Point3f, Vector3f
from djpt.shapes.curve_segments import cubic_at
from djpt.shapes.meshes.mesh_set import MeshSet
from djpt.validation import agreement
from tests.kit.kernels import Watched
from tests.kit.mesh_scenes import ball_file
from tests.kit.renders import ours, theirs

KINDS = ("linearcurve", "bsplinecurve")


def strands(count: int = 12, length: int = 6, radius: float = 0.04, seed: int = 5) -> list[np.ndarray]:
    """Bent strands that start on a small ball and taper off, (length, 4) each."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        step = rng.normal(size=3)
        step *= 0.15 / np.linalg.norm(step)
        place, points = step / 0.3, []
        for k in range(length):
            points.append([*place, radius * (1 - 0.1 * k)])
            step = step + 0.05 * rng.normal(size=3)
            step *= 0.15 / np.linalg.norm(step)
            place = place + step
        found.append(np.array(points).astype(np.float32).astype(np.float64))
    return found


def file_of(curves: list[np.ndarray], folder: Path) -> str:
    path = folder / "curves.txt"
    path.write_text("\n\n".join("\n".join(" ".join(map(repr, map(float, row))) for row in c) for c in curves) + "\n")
    return str(path)


def scene_of(kind: str, path: str, **keys: Any) -> dict[str, Any]:
    return {"type": "scene", "hair": {"type": kind, "filename": path, **keys}}


def rays(count: int = 4000, seed: int = 1, size: float = 1.2) -> tuple[np.ndarray, np.ndarray]:
    """Origins on a sphere about the scene, and unit directions to its inside: (3, N) float32."""
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(3, count))
    o *= 3 * size / np.linalg.norm(o, axis=0)
    d = size * rng.uniform(-1, 1, (3, count)) - o
    return o.astype(np.float32), (d / np.linalg.norm(d, axis=0)).astype(np.float32)


def hits(scene: Any, o: np.ndarray, d: np.ndarray) -> Any:
    return scene.ray_intersect(djpt.Ray3f(Point3f(o), Vector3f(d)))


def segments(kind: str, curves: list[np.ndarray]) -> np.ndarray:
    """The control points of all segments, (S, 2 or 4, 4)."""
    count = 2 if kind == "linearcurve" else 4
    return np.array([c[k : k + count] for c in curves for k in range(len(c) - count + 1)])


V = np.linspace(0, 1, 257)


def centres(kind: str, curves: list[np.ndarray]) -> np.ndarray:
    """Points along all segments, (S V, 4)."""
    parts = segments(kind, curves)
    if kind == "linearcurve":
        return (parts[:, None, 0] * (1 - V)[:, None] + parts[:, None, 1] * V[:, None]).reshape(-1, 4)
    return np.concatenate([cubic_at(np.broadcast_to(part, (len(V), 4, 4)), V) for part in parts])


def clearance(balls: np.ndarray, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The least distance between each ray's line and the balls, negative where it meets one."""
    found = []
    for origin, direction in zip(o.T.astype(np.float64), d.T.astype(np.float64), strict=True):
        away = balls[:, :3] - origin
        across = away - np.outer(away @ direction, direction)
        found.append((np.linalg.norm(across, axis=1) - balls[:, 3]).min())
    return np.array(found)


# ---------------------------------------------------------------- hits


@pytest.mark.slow
def test_linear_curves_are_hulls_of_balls(tmp_path: Path) -> None:
    curves = strands()
    scene, (o, d) = djpt.load_dict(scene_of("linearcurve", file_of(curves, tmp_path))), rays(1500)
    si = hits(scene, o, d)
    hit, balls = np.array(si.is_valid()), centres("linearcurve", curves)
    gap = clearance(balls, o, d)
    assert 0.05 < hit.mean() < 0.95
    assert (hit == (gap < 0))[np.abs(gap) > 1e-4].all()
    p = np.array(si.p).astype(np.float64)[:, hit]
    depth = (np.linalg.norm(p.T[:, None] - balls[None, :, :3], axis=2) - balls[None, :, 3]).min(axis=1)
    assert np.abs(depth).max() < 2e-5
    assert (np.array(dr.dot(si.n, Vector3f(d)))[hit] < 0).all()
    assert (np.array(scene.ray_test(djpt.Ray3f(Point3f(o), Vector3f(d)))) == hit).all()


@pytest.mark.slow
def test_cubic_curves_are_swept_circles(tmp_path: Path) -> None:
    """Of a hit the circle is known, by v: the point lies in its plane, at its radius."""
    curves = strands()
    scene, (o, d) = djpt.load_dict(scene_of("bsplinecurve", file_of(curves, tmp_path))), rays(4000)
    si = hits(scene, o, d)
    hit = np.array(si.is_valid())
    parts = segments("bsplinecurve", curves)
    place = np.array(si.uv)[1][hit].astype(np.float64) * len(parts)
    number = np.clip(place.astype(int), 0, len(parts) - 1)
    v, controls, p = place - number, parts[number], np.array(si.p).astype(np.float64).T[hit]
    c, step = cubic_at(controls, v), 1e-4
    tangent = cubic_at(controls, v + step)[:, :3] - cubic_at(controls, v - step)[:, :3]
    out = p - c[:, :3]
    inside = (v > 1e-3) & (v < 1 - 1e-3)
    cosine = (out * tangent).sum(axis=1) / np.linalg.norm(out, axis=1) / np.linalg.norm(tangent, axis=1)
    assert np.abs(cosine[inside]).max() < 2e-3
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), c[:, 3], rtol=1e-4)
    # Rays that miss all balls about the curve miss it; those that meet one go in, away from the open ends,
    # unless they came through one: then they are inside already.
    assert not hit[clearance(centres("bsplinecurve", curves), o, d) > 1e-3].any()
    within = np.concatenate([centres("bsplinecurve", [curve])[100:-100] for curve in curves])
    assert hit[clearance(within, o, d) < -2e-3].mean() > 0.95
    along = np.linalg.norm(np.cross(p - o.T[hit], d.T[hit]), axis=1)
    assert np.quantile(along, 0.99) < 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_hits_are_mitsubas(kind: str, tmp_path: Path) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    path = file_of(strands(40, radius=0.02), tmp_path)
    o, d = rays(20000)
    mine = hits(djpt.load_dict(scene_of(kind, path)), o, d)
    its = mi.load_dict(scene_of(kind, path)).ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    both = np.array(mine.is_valid()) & np.array(its.is_valid())
    assert both.mean() > 0.05 and (np.array(mine.is_valid()) != np.array(its.is_valid())).mean() < 1e-3
    for name, tolerance in (("t", 2e-3), ("p", 1e-4), ("n", 1e-2), ("uv", 1e-3)):
        a, b = (np.atleast_2d(np.array(getattr(si, name), np.float64))[:, both] for si in (mine, its))
        share = (np.abs(a - b).max(axis=0) < tolerance).mean()
        print(f"{kind} {name}: {share:.4f}")
        assert share > 0.985


@pytest.mark.parametrize("kind", KINDS)
def test_searches_by_steps_and_by_calls_agree(kind: str, tmp_path: Path) -> None:
    path, (o, d) = file_of(strands(), tmp_path), rays(2000)
    found = []
    for engine in ("steps", "call"):
        with ray_queries(engine):
            found.append(hits(djpt.load_dict(scene_of(kind, path)), o, d))
    a, b = (np.array(si.is_valid()) for si in found)
    assert (a != b).mean() < 2e-3
    for name in ("t", "uv"):
        x, y = (np.atleast_2d(np.array(getattr(si, name)))[:, a & b] for si in found)
        assert (np.abs(x - y).max(axis=0) < 1e-3).mean() > 0.98


# ---------------------------------------------------------------- surfaces


@pytest.mark.parametrize("kind", KINDS)
def test_partials_are_the_changes_of_the_point(kind: str, tmp_path: Path) -> None:
    """Two hits that are close: p moves by dp_du du + dp_dv dv."""
    path, (o, d) = file_of(strands(radius=0.08), tmp_path), rays(4000)
    scene = djpt.load_dict(scene_of(kind, path))
    first = hits(scene, o, d)
    side = np.cross(d.T, [0.3, -0.5, 0.8]).T
    second = hits(scene, o + 2e-4 * side.astype(np.float32), d)
    same = np.array(first.is_valid() & second.is_valid() & (first.prim_index == second.prim_index))
    # Where balls are seen, along the axis nothing changes with the point.
    same &= np.array((first.prim_uv.x > 0) & (first.prim_uv.x < 1))
    (du, dv), cos = (np.array(second.uv) - np.array(first.uv))[:, same], np.array(dr.dot(first.n, Vector3f(d)))[same]
    moved = (np.array(second.p) - np.array(first.p))[:, same]
    told = np.array(first.dp_du)[:, same] * du + np.array(first.dp_dv)[:, same] * dv
    steep = (cos < -0.5) & (np.abs(du) < 0.1)
    error = np.linalg.norm(moved - told, axis=0) / np.linalg.norm(moved, axis=0)
    assert steep.sum() > 100 and np.quantile(error[steep], 0.9) < 0.03


def test_tubes_are_open_and_hulls_are_round(tmp_path: Path) -> None:
    straight = [np.array([[0, 0, k, 0.5] for k in range(6)], np.float64)]
    path = file_of(straight, tmp_path)
    o = np.array([[0.1, 0.1, 0.45], [0, 0.2, 0], [-9, 9, -9]], np.float32)
    d = np.array([[0, 0, 0], [0, 0, 0], [1, -1, 1]], np.float32)
    tube, hull = (djpt.load_dict(scene_of(kind, path)) for kind in ("bsplinecurve", "linearcurve"))
    assert not np.array(hits(tube, o, d).is_valid()).any()
    np.testing.assert_allclose(
        np.array(hits(hull, o, d).t), 9 - np.sqrt(0.25 - (o[:2] ** 2).sum(axis=0)) + [0, -5, 0][:1], atol=6
    )
    ends = np.array(hits(hull, o, d).p)[2]
    expected = np.sqrt(0.25 - (o[:2].astype(np.float64) ** 2).sum(axis=0))
    np.testing.assert_allclose(ends, [-expected[0], 5 + expected[1], -expected[2]], atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_curves_are_not_seen_from_inside(kind: str, tmp_path: Path) -> None:
    ends = (0, 5) if kind == "linearcurve" else range(6)  # balls at joints are seen from within
    straight = [np.array([[0, 0, k, 0.5] for k in ends], np.float64)]
    scene = djpt.load_dict(scene_of(kind, file_of(straight, tmp_path)))
    rng = np.random.default_rng(3)
    o = np.stack([*rng.uniform(-0.3, 0.3, (2, 200)), rng.uniform(1.5, 3.5, 200)]).astype(np.float32)
    d = rng.normal(size=(3, 200)).astype(np.float32)
    assert not np.array(hits(scene, o, d).is_valid()).any()


def test_balls_in_place_of_segments_without_length(tmp_path: Path) -> None:
    path = file_of([np.array([[0, 0, 0, 1], [0, 0, 0, 1.0]]), np.array([[3, 0, 0, 1], [3.2, 0, 0, 0.5]])], tmp_path)
    scene = djpt.load_dict(scene_of("linearcurve", path))
    si = hits(
        scene, np.array([[0.5, 3.5], [0, 0], [-5, -5]], np.float32), np.array([[0, 0], [0, 0], [1, 1]], np.float32)
    )
    np.testing.assert_allclose(np.array(si.t), 5 - np.sqrt(0.75), rtol=1e-5)
    np.testing.assert_allclose(np.array(si.n)[0], 0.5, atol=1e-4)


# ---------------------------------------------------------------- scenes


def picture(kind: str, path: str, **keys: Any) -> dict[str, Any]:
    look = T().look_at(origin=[0, -5, 0], target=[0, 0, 0], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}}
    return {
        **scene_of(kind, path, bsdf={"type": "roughplastic", "diffuse_reflectance": 0.4}, **keys),
        "floor": {"type": "rectangle", "to_world": T().translate([0, 0, -1]).scale(3)},
        "sky": {"type": "constant"},
        "lamp": {"type": "point", "position": [1, -3, 3], "intensity": 20.0},
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {"type": "perspective", "fov": 35, "to_world": look, "film": film},
    }


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.sparse(2)
def test_images_are_mitsubas(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    result = djpt.validation.compare(picture(kind, file_of(strands(), tmp_path)), spp=64, same_seed_spp=0)
    assert result.passed, result


@pytest.mark.parametrize("kind", KINDS)
def test_surfaces_are_mitsubas(kind: str, tmp_path: Path) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    path, (o, d) = file_of(strands(radius=0.1), tmp_path), rays(6000, size=0.6)
    mine = hits(djpt.load_dict(scene_of(kind, path)), o, d)
    its = mi.load_dict(scene_of(kind, path)).ray_intersect(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    a, b = np.array(mine.is_valid()), np.array(its.is_valid())
    assert (a != b).mean() < 5e-3
    # Mitsuba 3.9.1 gives linear curves no tangents, and those along other curves aren't changes of the point.
    for name in ("t", "p", "n", "uv", *(["dp_du"] if kind == "bsplinecurve" else [])):
        x, y = (np.atleast_2d(np.array(getattr(si, name)))[:, a & b] for si in (mine, its))
        assert (np.abs(x - y).max(axis=0) < 2e-3 * (1 + np.abs(y).max(axis=0))).mean() > 0.97, name


def test_equal_pixels_in_mirrors(tmp_path: Path) -> None:
    """Linear curves that reflect, so that their tangents don't matter: equal numbers lead to equal pixels."""
    pytest.importorskip("mitsuba")
    scene = {**picture("linearcurve", file_of(strands(radius=0.1), tmp_path)), "lamp": {"type": "constant"}}
    scene["hair"]["bsdf"] = {"type": "conductor", "material": "Au"}
    del scene["sky"]
    assert agreement(ours(scene, 4, 3), theirs(scene, 4, 3), 1e-3).share > 0.97


@pytest.mark.parametrize("kind", KINDS)
def test_curves_in_instances_grow_with_them(kind: str, tmp_path: Path) -> None:
    curves, place = strands(4), T().translate([0.2, 0.1, 0.3]).rotate([1, 0, 0], 40).scale(0.5)
    group = {"type": "shapegroup", "hair": {"type": kind, "filename": file_of(curves, tmp_path)}}
    instance = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}
    o, d = rays(8000, size=0.5)
    found = hits(djpt.load_dict({"type": "scene", "group": group, "one": instance}), o, d)
    moved = [np.column_stack([c[:, :3] @ place.matrix[:3, :3].T + place.matrix[:3, 3], 0.5 * c[:, 3]]) for c in curves]
    expected = hits(djpt.load_dict(scene_of(kind, file_of(moved, tmp_path))), o, d)
    same = np.array(found.is_valid()) == np.array(expected.is_valid())
    assert same.mean() > 0.998 and np.array(found.is_valid()).mean() > 0.005
    both = np.array(found.is_valid() & expected.is_valid())
    assert (np.abs(np.array(found.t) - np.array(expected.t))[both] < 1e-3).mean() > 0.99


@pytest.mark.parametrize("kind", KINDS)
def test_an_edit_moves_curves_and_compiles_nothing(kind: str, tmp_path: Path) -> None:
    curves = strands(4)
    watched = Watched(picture(kind, file_of(curves, tmp_path)))
    moved = [np.column_stack([c[:, [1, 2, 0]], 0.7 * c[:, 3]]) for c in curves]
    watched.params["hair.control_points"] = np.concatenate(moved).ravel().astype(np.float32)
    watched.params.update()
    assert watched.new() == 0
    o, d = rays(1000)
    expected = hits(djpt.load_dict(picture(kind, file_of(moved, tmp_path))), o, d)
    np.testing.assert_array_equal(np.array(hits(watched.scene, o, d).t), np.array(expected.t))


def test_an_edit_that_bends_curves_changes_their_pieces(tmp_path: Path) -> None:
    """A straight curve is one piece, and a bent one is many: none is lost, and none is left over."""
    straight = np.column_stack([np.linspace(-1, 1, 5), np.zeros((5, 2)), np.full(5, 0.1)])
    bent = straight + 0.4 * np.outer([1, -1, 1, -1, 1], [0, 1, 0, 0])
    o, d = rays(3000, size=0.7)
    scenes = [djpt.load_dict(scene_of("bsplinecurve", file_of([c], tmp_path))) for c in (straight, bent)]
    first = [np.array(hits(scene, o, d).t) for scene in scenes]
    for scene, points, expected in zip(scenes, (bent, straight), reversed(first), strict=True):
        params = djpt.traverse(scene)
        params["hair.control_points"] = points.ravel().astype(np.float32)
        params.update()
        np.testing.assert_array_equal(np.array(hits(scene, o, d).t), expected)


def test_texture_coordinates_determine_points_of_splines(tmp_path: Path) -> None:
    """They are those of the point, which lies on the curve."""
    hair = djpt.load_dict(scene_of("bsplinecurve", file_of(strands(), tmp_path))["hair"])
    uv = np.random.default_rng(2).random((2, 500)).astype(np.float32) * 0.98 + 0.01
    si = hair.eval_parameterization(djpt.Point2f(uv))
    np.testing.assert_allclose(np.array(si.uv), uv, atol=2e-3)
    back = hair.ray_intersect(djpt.Ray3f(si.p + si.n, -si.n))
    same = np.abs(np.array(back.t) - 1) < 1e-3  # the others are hidden by another strand
    assert same.mean() > 0.8 and (np.array(si.t) == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_curves_beside_a_smooth_mesh(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The word that is a face in the record of a triangle numbers pieces in those of curves, beyond the last face."""
    faces: list[np.ndarray] = []
    plain = MeshSet.surface

    def watched(self: MeshSet, face: Any, *rest: Any) -> Any:
        faces.append(np.array(face))
        return plain(self, face, *rest)

    monkeypatch.setattr(MeshSet, "surface", watched)
    described = scene_of(kind, file_of(strands(), tmp_path))
    described["ball"] = {"type": "ply", "filename": ball_file(tmp_path, rows=3), "to_world": T().scale(0.2)}
    scene = djpt.load_dict(described)
    si = hits(scene, *rays())
    found = np.bincount(np.array(si.shape_index)[np.array(si.is_valid())], minlength=2)
    assert found.min() > 20 and faces
    assert max(face.max() for face in faces) < scene.shapes()[1].face_count()


def test_parameters(tmp_path: Path) -> None:
    shape = djpt.load_dict({"type": "bsplinecurve", "filename": file_of(strands(2), tmp_path)})
    params = djpt.traverse(shape)
    assert params["control_point_count"] == 12 and shape.primitive_count() == 6
    assert np.array(params["segment_indices"]).tolist() == [0, 1, 2, 6, 7, 8]
    with pytest.raises(djpt.ParameterError, match="must be 12 points, found 1"):
        params["control_points"] = [0.0, 0, 0, 1]
        params.update()
    with pytest.raises(djpt.ParameterError, match="radii must be at least 0"):
        params["control_points"] = -Float(params["control_points"])
        params.update()


def test_to_world_moves_points_and_keeps_radii(tmp_path: Path) -> None:
    curves = strands(2)
    shape = djpt.load_dict({"type": "linearcurve", "filename": file_of(curves, tmp_path), "to_world": T().scale(3)})
    np.testing.assert_allclose(shape.points, np.concatenate(curves) * [3, 3, 3, 1], rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "keys", "message"),
    [
        ("0 0 0 1\n0 0 1\n", {}, "line 2: must be x y z and a radius of at least 0, found fewer words"),
        ("0 0 0 1\n0 0 1 -1\n", {}, "line 2: must be x y z and a radius of at least 0, found a negative radius"),
        ("0 0 0 1\n0 0 one 1\n", {}, "line 2: must be x y z and a radius of at least 0, found other words"),
        ("0 0 0 1\n0 0 nan 1\n", {}, "line 2: must be x y z and a radius of at least 0, found other words"),
        ("0 0 0 1\n\n0 0 1 1\n1 1 1 1", {}, "curve 0 has 1 control points; 2 are needed"),
        ("\n\n", {}, "no control points in the file"),
        ("0 0 0 1\n0 0 1 1\n", {"emitter": {"type": "area"}}, "curves can't emit light"),
        ("0 0 0 1\n0 0 1 1\n", {"flip_normals": True}, "curves are visible only from outside"),
    ],
)
def test_errors(text: str, keys: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "curves.txt"
    path.write_text(text)
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "linearcurve", "filename": str(path), **keys})


def test_points_and_areas_that_are_not_known_are_refused(tmp_path: Path) -> None:
    grid = djpt.TensorXf([-1.0, 1.0] * 4, (2, 2, 2, 1))
    curves = [{"type": kind, "filename": file_of(strands(2), tmp_path)} for kind in KINDS]
    for description in ({"type": "sdfgrid", "grid": grid}, *curves):
        shape = djpt.load_dict(description)
        with pytest.raises(djpt.SceneError, match="points of this shape aren't sampled"):
            shape.sample_position(0, [0.1, 0.2])
        with pytest.raises(djpt.SceneError, match="the area of this shape isn't known"):
            shape.surface_area()
