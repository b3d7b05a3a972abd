"""Silhouettes of shapes that Mitsuba doesn't have: what they are by definition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.jit.types import Float, Point3f, UInt32
from djpt.scene.instance_copies import with_copies
from djpt.shapes.mesh import Mesh
from djpt.shapes.silhouettes.foreground import seen_at, toward_viewer
from tests.kit.axes import unit

PERIMETER, INTERIOR, LUNE, SPHERE, CREASES = 1, 2, 4, 8, 32
TURNED = T().translate([0.1, 0.2, 0.3]).rotate(unit(1, 1, 0), 30).scale(0.8)


def box(split: bool) -> Any:
    """A box of twelve triangles, with a vertex per corner, or with one per corner and face."""
    cube = djpt.load_dict({"type": "cube", "to_world": TURNED.scale([1, 0.5, 0.7])})
    points = np.array(cube.vertex_positions).reshape(-1, 3)
    faces = np.array(cube.faces_parameter).reshape(-1, 3)
    if not split:
        points, places = np.unique(points.round(5), axis=0, return_inverse=True)
        faces = places.ravel()[faces]
    found = Mesh("box", points.astype(np.float32), faces)
    params = djpt.traverse(found)
    dr.enable_grad(params["vertex_positions"])
    params.update()
    return found


def shape(name: str) -> Any:
    if "mesh" in name:
        return box("seams" in name)
    return djpt.load_dict(SHAPES[name])


SHAPES: dict[str, Any] = {
    "cone": {"type": "cone", "to_world": TURNED},
    "a slender cone": {"type": "cone", "to_world": TURNED, "angle": 25, "length": 1.5, "flip_normals": True},
    "paraboloid": {"type": "paraboloid", "to_world": TURNED},
    "a shallow paraboloid": {"type": "paraboloid", "to_world": TURNED, "focal_length": 0.6, "length": 0.7},
    "cube": {"type": "cube", "to_world": TURNED.scale([1, 0.5, 0.7])},
    "cylinder": {"type": "cylinder", "to_world": TURNED, "flip_normals": True},
    "sphere": {"type": "sphere", "flip_normals": True},
    "torus": {"type": "torus", "to_world": TURNED.scale([1, 0.7, 1.2])},
    "strand": {"type": "bsplinecurve", "filename": str(Path(__file__).parent / "strand.txt")},
    "a thick torus": {"type": "torus", "to_world": TURNED, "major": 0.6, "minor": 0.4, "flip_normals": True},
}
NAMES = [*SHAPES, "mesh", "mesh with seams"]


def lanes(value: Any, count: int) -> Any:
    """A Dr.Jit array on the host, as wide as others."""
    found = np.array(dr.detach(value))
    return np.broadcast_to(found, (*found.shape[:-1], count))


def meets(one: Any, name: str, ray: Any, count: int) -> Any:
    """Whether rays meet the shape; of those that hide parts of their outlines, only close to where they begin."""
    if "torus" in name or name == "strand":
        ray.maxt = Float(0.01)
    return lanes(one.ray_test(ray), count)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("flags", [PERIMETER | SPHERE, INTERIOR, PERIMETER | SPHERE | CREASES, PERIMETER | LUNE])
@pytest.mark.sparse(8)
def test_samples_graze_the_shape(name: str, flags: int) -> None:
    """They can be inverted, `n` and `silhouette_d` are unit vectors perpendicular to each other, and rays pass by."""
    one, count = shape(name), 500
    points = np.random.default_rng(3).random((3, count)).astype(np.float32) * 0.998 + 0.001
    ss = one.sample_silhouette(Point3f(points), flags)
    valid = lanes(ss.is_valid(), count)
    if not valid.any():
        assert not one.silhouette_discontinuity_types() & flags
        return
    back = lanes(one.invert_silhouette_sample(ss), count)
    np.testing.assert_allclose(back[:, valid], points[:, valid], atol=5e-4)
    d, n, along = (lanes(getattr(ss, key), count)[:, valid] for key in ("d", "n", "silhouette_d"))
    np.testing.assert_allclose([(d * n).sum(0), (along * n).sum(0)], 0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(along, axis=0), 1, atol=1e-5)
    bent = name in ("cube", "mesh", "mesh with seams")
    if (bent and not flags & CREASES) or flags == INTERIOR:
        for ray in (ss.spawn_ray(), ss.toward_viewer().spawn_ray()):
            assert meets(one, name, ray, count)[valid].mean() < 0.01


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("creases", [False, True])
@pytest.mark.sparse(12)
def test_outlines_have_their_length(name: str, creases: bool) -> None:
    """The length of a part of the outline is the mean of 1 / pdf; what it looks at is seen from the viewpoint."""
    one, count = shape(name), 2001
    fraction = Float(((np.arange(count) + 0.5) / count).astype(np.float32))
    for viewpoint in (Point3f(3, -2.5, 4), Point3f(0.3, 3, -1)):
        parts, weights = one.precompute_silhouette(viewpoint, creases)
        assert lanes(weights, len(parts)).min() > 0
        for part in np.array(parts):
            ss = one.sample_precomputed_silhouette(viewpoint, UInt32(part), fraction)
            valid = lanes(ss.is_valid(), count)
            if not valid.any():
                continue
            p, pdf = np.array(ss.p)[:, valid], lanes(ss.pdf, count)[valid]
            steps = np.linalg.norm(np.diff(p, axis=1), axis=0)
            length = steps[steps < 20 * np.median(steps)].sum()
            assert (1 / pdf).sum() / count == pytest.approx(length, rel=3e-3)
            np.testing.assert_allclose((lanes(ss.n, count) * lanes(ss.d, count)).sum(0)[valid], 0, atol=1e-5)
            # A surface may hide its own rim.
            if part != PERIMETER or "cube" in name or "mesh" in name:
                hits = meets(one, name, ss.toward_viewer().spawn_ray(), count)[valid].mean()
                assert hits < 0.01


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.sparse(4)
def test_outlines_seen_from_far_away(name: str) -> None:
    """They have the length that they have from a hundredth of the distance, and rounding doesn't destroy them."""
    one, count = shape(name), 2001
    fraction = Float(((np.arange(count) + 0.5) / count).astype(np.float32))
    lengths = []
    for distance in (300, 3e4):
        viewpoint, length = Point3f(0.5, -0.6, 0.4) * distance, 0.0
        for part in np.array(one.precompute_silhouette(viewpoint)[0]):
            ss = one.sample_precomputed_silhouette(viewpoint, UInt32(part), fraction)
            valid = lanes(ss.is_valid(), count)
            length += (1 / lanes(ss.pdf, count)[valid]).sum() / count
            np.testing.assert_allclose((lanes(ss.n, count) * lanes(ss.d, count)).sum(0)[valid], 0, atol=2e-4)
        lengths.append(length)
    assert lengths[0] > 0 and lengths[1] == pytest.approx(lengths[0], rel=0.01)


@pytest.mark.parametrize("seams", [False, True])
def test_a_mesh_of_a_box_has_the_outline_of_the_box(seams: bool) -> None:
    """Six edges, whether vertices of its faces are shared or not; with creases also the three that meet before."""
    for creases, count in ((False, 6), (True, 9)):
        parts, _ = box(seams).precompute_silhouette(Point3f(3, -2.5, 4), creases)
        cube, _ = shape("cube").precompute_silhouette(Point3f(3, -2.5, 4), creases)
        assert len(parts) == len(cube) == count


def test_boxes_move_with_their_corners() -> None:
    """Derivatives by the corners are those of the box that fits, and points stick to it."""
    scene = djpt.load_dict({"type": "scene", "a": {"type": "cube", "to_world": TURNED}, "b": {"type": "cuboid"}})
    params = djpt.traverse(scene)
    theta = Float(0)
    dr.enable_grad(theta)
    corners = dr.unravel(Point3f, Float(params["a.vertex_positions"]))
    motion = djpt.Transform4f().translate([theta, 2 * theta, 0]).rotate([0, 0, 1], 90 * theta)
    params["a.vertex_positions"] = dr.ravel(motion.transform_point(corners))
    params["b.max"] = Point3f(1 + theta, 1, 1)
    params.update()
    a, b = scene.shapes()
    si = dr.zeros(djpt.SurfaceInteraction3f)
    si.uv, si.prim_index = djpt.Point2f(0.3, 0.6), UInt32(6)
    places = [one.silhouette().follow(si.prim_index, si.uv, True) for one in (a, b)]
    at = np.array(dr.detach(places[0])).ravel()
    dr.forward(theta)
    expected = [1 - np.pi / 2 * at[1], 2 + np.pi / 2 * at[0], 0]
    np.testing.assert_allclose(np.array(dr.grad(places[0])).ravel(), expected, atol=1e-4)
    # A corner at x = 1 moves by theta, one at -1 doesn't.
    np.testing.assert_allclose(np.array(dr.grad(places[1])).ravel(), [(places[1].x[0] + 1) / 2, 0, 0], atol=1e-5)


def test_copies_move_as_their_instance_does() -> None:
    """A mesh, a ball and a box in a group that turns about the z axis."""
    group = {
        "type": "shapegroup",
        "a": box(False),
        "b": {"type": "sphere", "center": [1, 2, 3]},
        "c": {"type": "cube", "to_world": TURNED},
    }
    description = {"type": "scene", "group": group, "i": {"type": "instance", "of": {"type": "ref", "id": "group"}}}
    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    theta = Float(0)
    dr.enable_grad(theta)
    params["i.to_world"] = djpt.Transform4f().translate([0, 0, theta]).rotate([0, 0, 1], 90 * theta)
    params.update()
    copies = with_copies(scene).shapes()
    assert [copied.id() for copied in copies] == ["i.box", "i.group.b", "i.group.c"]
    assert all(copied.parameters_grad_enabled() for copied in copies)
    uv, triangle = djpt.Point2f(0.3, 0.6), UInt32(6)
    places = [copied.silhouette().follow(triangle, uv, True) for copied in copies]
    at = [np.array(dr.detach(p)).ravel() for p in places]
    dr.forward(theta)
    for p, change in zip(at, places, strict=True):
        expected = [-np.pi / 2 * p[1], np.pi / 2 * p[0], 1]
        np.testing.assert_allclose(np.array(dr.grad(change)).ravel(), expected, atol=1e-4)


@pytest.mark.parametrize("origin", [(-0.1, -0.5, -4.0), (0.2, 0.1, 0.3)])
@pytest.mark.parametrize("cosine", [0.0, 0.4, None])
def test_points_at_another_cosine_mirror_light_from_where_they_did(origin: tuple[float, ...], cosine: Any) -> None:
    """Points of a ball, seen from outside and from inside; None: at their own cosine, which changes nothing."""
    scene = djpt.load_dict({"type": "scene", "ball": {"type": "sphere"}})
    d = djpt.Vector3f(*unit(0.1, 0.2, 1))
    si = toward_viewer(scene.ray_intersect(djpt.Ray3f(djpt.Point3f(*origin), d)), d)
    own = float(si.wi.z[0])
    wanted = abs(own) if cosine is None else cosine
    turned, onward = seen_at(si, d, Float(wanted))
    expected = si.to_world(djpt.Vector3f(-si.wi.x, -si.wi.y, si.wi.z))
    mirrored = turned.to_world(djpt.Vector3f(-turned.wi.x, -turned.wi.y, turned.wi.z))
    np.testing.assert_allclose(np.array(mirrored), np.array(expected), atol=1e-5)
    assert float(turned.wi.z[0]) == pytest.approx(np.copysign(wanted, own), abs=3e-5)
    # The viewer is on the same side, and looks that way.
    again = toward_viewer(turned, onward)
    np.testing.assert_allclose(np.array(again.wi), np.array(turned.wi), atol=1e-6)
    if cosine is None:
        for a, b in ((onward, d), (turned.n, si.n), (turned.sh_frame.n, si.sh_frame.n), (turned.wi, si.wi)):
            np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-5)


def test_silhouettes_of_bent_tubes_run_across_the_line_of_sight() -> None:
    """`foreshortening` is how fast the normal turns along `d`, and it doesn't turn towards `d` along the silhouette."""
    one, count, step = shape("strand"), 500, 1e-2
    silhouette: Any = one.silhouette()
    points = np.random.default_rng(1).random((3, count)).astype(np.float32) * 0.9 + 0.05
    ss = one.sample_silhouette(Point3f(points), INTERIOR)
    v, phi = silhouette.v(ss.prim_index, ss.uv), ss.uv.x * (2 * np.pi)

    def change(by_phi: float, by_v: float) -> tuple[Any, Any]:
        """The differences of the point and of the normal."""
        places = []
        for sign in (1, -1):
            ring, _ = silhouette.ring(ss.prim_index, v + sign * by_v, True)
            out = ring.out(phi + sign * by_phi)
            places.append((np.array(ring.point(out)), np.array(ring.normal(out))))
        return tuple((a - b) / (2 * step) for a, b in zip(*places, strict=True))

    (p_u, n_u), (p_v, n_v) = change(step, 0), change(0, step)
    d, along = np.array(ss.d), np.array(ss.silhouette_d)
    tangents = np.stack([p_u, p_v], axis=-1).transpose(1, 0, 2)
    shares = np.stack([np.linalg.lstsq(t, x, rcond=None)[0] for t, x in zip(tangents, d.T, strict=True)], axis=1)
    turning = shares[0] * n_u + shares[1] * n_v
    np.testing.assert_allclose(np.array(ss.foreshortening), np.abs((turning * d).sum(0)), rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose((turning * along).sum(0), 0, atol=1e-3 * np.linalg.norm(turning, axis=0).max())
