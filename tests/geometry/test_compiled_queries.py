"""Ray queries by calls: the hits of steps, and of all triangles one by one; edges; memory; the option."""

from __future__ import annotations

import gc
from typing import Any

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from djpt.core.records import Ray3f
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import SceneError
from djpt.geometry import engines
from djpt.geometry.accelerators.brute_force import BruteForce
from djpt.geometry.bvh.calls import searches
from djpt.geometry.bvh.calls.trees import CompiledTree
from djpt.geometry.engines import chosen, ray_queries
from djpt.geometry.query import NONE
from djpt.jit.llvm.calls import CallError
from djpt.jit.types import Bool, Float, Point3f, UInt32, Vector3f
from tests.kit.axes import unit
from tests.kit.triangle_soups import SOUPS, sphere

SEARCHES = [search for search in searches.SEARCHES if searches.why_not(search) is None]
FASTEST = SEARCHES[0] if SEARCHES else "call"

pytestmark = [
    pytest.mark.narrow,
    pytest.mark.skipif(not SEARCHES, reason="calls don't work on this machine"),
]
by_rings = pytest.mark.skipif("rings" not in SEARCHES, reason="rings need AVX2")

Floats = NDArray[np.float64]


class OneSided(djpt.Mesh):
    """A mesh that rays pass through from behind."""

    one_sided = True


def mesh(corners: NDArray[np.float32], kind: type[djpt.Mesh] = djpt.Mesh, **props: Any) -> djpt.Mesh:
    """A mesh of separate triangles."""
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return kind("soup", corners.reshape(-1, 3), faces, props=props)


def rays_at(corners: NDArray[np.float32], count: int, seed: int = 0) -> Ray3f:
    """Rays at triangles from all around, some with an end before or behind the target."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet([1, 1, 1], count)
    target = np.einsum("ij,ijk->ik", weights, corners[rng.integers(0, len(corners), count)].astype(np.float64))
    size = np.linalg.norm(np.ptp(corners.reshape(-1, 3), axis=0))
    o = target + size * rng.normal(size=(count, 3)) * 10 ** rng.uniform(-1, 0.5, (count, 1))
    end = np.where(rng.random(count) < 0.3, rng.uniform(0.5, 1.5, count), np.inf)
    return Ray3f(Point3f(*o.T), Vector3f(*(target - o).T), maxt=Float(end))


def scene(ways: str, *shapes: Any, **more: Any) -> djpt.Scene:
    """A scene of shapes, searched by `ways`."""
    with ray_queries(ways):
        return djpt.load_dict({"type": "scene", **{f"s{i}": shape for i, shape in enumerate(shapes)}, **more})


# Of triangles that shrink without end, which are hit is a matter of rounding.
@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("name", sorted(SOUPS.keys() - {"exponential"}))
@pytest.mark.sparse(4)
def test_hits_are_those_of_all_triangles_one_by_one(name: str, search: str) -> None:
    corners = SOUPS[name]()
    calls, ray = scene(search, mesh(corners)), rays_at(corners, 4000)
    t, _ = BruteForce(corners).closest(ray)
    found, expected = np.array(calls.ray_intersect_preliminary(ray).t), np.array(t)
    both = np.isfinite(found) & np.isfinite(expected)
    # A ray that grazes an edge may hit by one rounding and miss by another.
    assert np.mean(np.isfinite(found) != np.isfinite(expected)) < 2e-3
    spacing = np.spacing(np.abs(corners).max()) / np.linalg.norm(np.array(ray.d), axis=0)[both]
    assert np.mean(np.abs(found - expected)[both] > 1e-4 * expected[both] + 8 * spacing) < 2e-3
    assert np.mean(np.array(calls.ray_test(ray)) != np.isfinite(found)) < 1e-3


def village(ways: str, one_sided: bool = False, solids: bool = True) -> djpt.Scene:
    """Meshes, solids in the tree, and instances, some of which emit light; some triangles may have one side.

    Without `solids` there are meshes in their place.
    """
    rng, kind = np.random.default_rng(1), OneSided if one_sided else djpt.Mesh
    kinds = ("sphere", "cube", "cylinder", "disk", "rectangle")
    shapes: list[Any] = [mesh(sphere(2000), kind), mesh(sphere(500) * np.float32(0.4) + np.float32([2, 0, 0]))]
    for i in range(40):
        place = T().translate(rng.uniform(-3, 3, 3).tolist()).rotate(unit(*rng.normal(size=3)), 50.0).scale(0.2)
        lamp: dict[str, Any] = {"emitter": djpt.load_dict({"type": "area"})} if i % 4 == 0 else {}
        if solids:
            shapes.append({"type": kinds[i % 5], "to_world": place, **lamp})
        else:
            corners = sphere(40) * np.float32(0.3) + np.float32(rng.uniform(-3, 3, 3))
            shapes.append(mesh(corners[:, ::-1], kind, **lamp))
    group = {"type": "shapegroup", "a": mesh(sphere(800), kind), "b": mesh(sphere(60) + np.float32(1))}
    copies = {}
    for i in range(30):
        place = T().translate(rng.uniform(-3, 3, 3).tolist()).rotate(unit(*rng.normal(size=3)), 70.0)
        copies[f"i{i}"] = {
            "type": "instance",
            "to_world": place.scale([0.2, 0.3, 0.1]),
            "g": {"type": "ref", "id": "g"},
        }
    return scene(ways, *shapes, g=group, **copies)


def rays_at_village(count: int) -> Ray3f:
    rng = np.random.default_rng(2)
    o, target = rng.normal(size=(3, count)) * 4, rng.uniform(-3, 3, (3, count))
    return Ray3f(Point3f(o), Vector3f(target - o))


def words(array: Any) -> NDArray[np.uint32]:
    return np.array(array).view(np.uint32)


@by_rings
@pytest.mark.parametrize("count", [10**5, pytest.param(10**7, marks=pytest.mark.slow)])
@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.sparse(4)
def test_rings_find_what_searches_one_by_one_find(one_sided: bool, count: int) -> None:
    """The same words: of meshes, instances of them, solids, lights that rays pass, surfaces with one side."""
    rng = np.random.default_rng(4)
    o, target = rng.normal(size=(3, count)) * 4, rng.uniform(-3, 3, (3, count))
    end = np.where(rng.random(count) < 0.3, rng.uniform(0.5, 1.5, count), np.inf)
    active, through = Bool(rng.random(count) < 0.9), Bool(rng.random(count) < 0.5)
    found = []
    for search in ("rings", "call"):
        tree = village(search, one_sided).geometry.triangles.tree  # type: ignore[union-attr]
        assert isinstance(tree, CompiledTree)
        ray = Ray3f(Point3f(o), Vector3f(target - o), maxt=Float(end))
        for lights in (Bool(False), through):
            met = tree.search(ray, False, active, lights)
            blocked = tree.search(ray, True, active, lights)
            assert met.b is not None
            found.append([words(x) for x in (met.t, met.record, met.inside, met.b.x, met.b.y, blocked.record)])
    hit = found[0][1] != NONE
    assert 0.2 < hit.mean() < 0.9
    assert (found[0][1] != found[1][1]).any(), "no ray passed through a light"
    for ours, theirs in ((found[0], found[2]), (found[1], found[3])):
        hit = theirs[1] != NONE
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a[hit], b[hit])
        np.testing.assert_array_equal(ours[1], theirs[1])
        np.testing.assert_array_equal(ours[-1], theirs[-1])


@by_rings
@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("lanes", [10**5 + 3, pytest.param(10**7, marks=pytest.mark.slow)])
@pytest.mark.sparse(2)
def test_pairs_find_what_two_searches_find(lanes: int, one_sided: bool) -> None:
    """The same words, of meshes, instances, lights that some rays pass; whichever lanes have a ray to a light."""
    rng = np.random.default_rng(5)
    geometry = village("rings", one_sided, solids=False).geometry
    assert geometry.triangles is not None
    tree = geometry.triangles.tree
    assert isinstance(tree, CompiledTree)
    assert tree.functions.pairs is not None, "pairs don't work on this machine"
    rays = []
    for _ in range(2):
        o, target = rng.normal(size=(3, lanes)) * 4, rng.uniform(-3, 3, (3, lanes))
        end = np.where(rng.random(lanes) < 0.3, rng.uniform(0.5, 1.5, lanes), np.inf)
        rays.append(Ray3f(Point3f(o), Vector3f(target - o), maxt=Float(end)))
    through = Bool(rng.random(lanes) < 0.5)
    share = np.repeat(rng.choice([0, 0.2, 1], lanes // 16 + 1), 16)[:lanes]
    followed = Bool(rng.random(lanes) < share)
    ours, hidden = tree.search_pairs(rays[0], rays[1], followed, through)
    theirs = tree.search(rays[0], False, True, through)
    blocked = tree.search(rays[1], True, followed).record != NONE
    assert 0.1 < np.mean(np.array(blocked)) < 0.5
    np.testing.assert_array_equal(np.array(hidden), np.array(blocked))
    hit = np.array(theirs.record) != NONE
    assert ours.b is not None and theirs.b is not None
    np.testing.assert_array_equal(np.array(ours.record), np.array(theirs.record))
    for a, b in (
        (ours.near_t, theirs.near_t),
        (ours.inside, theirs.inside),
        (ours.b.x, theirs.b.x),
        (ours.b.y, theirs.b.y),
    ):
        np.testing.assert_array_equal(words(a)[hit], words(b)[hit])


@by_rings
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_images_by_pairs_have_the_same_bits(rfilter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a camera ray sets out beside the last ray to a light, and where camera rays pass through lights."""
    view = {"type": "perspective", "to_world": T().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])}
    view["film"] = {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": rfilter}}
    place, sensor = village("rings", solids=False), djpt.load_dict(view)
    integrator = djpt.load_dict({"type": "path", "max_depth": 4, "hide_emitters": True})
    assert integrator.searches_pairs(place)

    def image() -> NDArray[np.float32]:
        return np.array(djpt.render(place, sensor=sensor, integrator=integrator, spp=6, schedule="flat"))

    in_pairs = image()
    monkeypatch.setattr(type(integrator), "searches_pairs", lambda *_: False)
    assert in_pairs.max() > 0
    np.testing.assert_array_equal(in_pairs, image())


def side_by_side(width: float, count: int, seed: int) -> Ray3f:
    """Groups of 64 rays within a beam of some width, towards the origin; some run along an axis."""
    rng = np.random.default_rng(seed)
    groups = count // 64
    middle = rng.normal(size=(groups, 1, 3))
    middle[::5, :, rng.integers(0, 3)] = 0
    middle *= rng.uniform(0.2, 4, (groups, 1, 1)) / np.linalg.norm(middle, axis=-1, keepdims=True)
    o = middle + width * 0.1 * rng.normal(size=(groups, 64, 3)) * (rng.random((groups, 1, 1)) < 0.5)
    d = -middle + width * rng.normal(size=(groups, 64, 3)) * (np.abs(middle) > 0)
    end = np.where(rng.random((groups, 64)) < 0.2, rng.uniform(0.3, 1.5, (groups, 64)), np.inf)
    return Ray3f(*(kind(*x.reshape(-1, 3).T) for kind, x in ((Point3f, o), (Vector3f, d))), maxt=Float(end.ravel()))


@by_rings
@pytest.mark.parametrize("width", [0.0, 1e-4, 0.01, 0.1])
@pytest.mark.sparse(2)
def test_rays_side_by_side_find_what_single_rays_find(width: float) -> None:
    """The same words, also where some lanes are off, of lights that rays pass and of surfaces with one side."""
    count, rng = 64 * 400, np.random.default_rng(6)
    ray = side_by_side(width, count, 7)
    active, through = Bool(rng.random(count) < 0.8), Bool(rng.random(count) < 0.5)
    found = []
    for search in ("rings", "call"):
        lamp = mesh(sphere(300) * np.float32(0.8), emitter=djpt.load_dict({"type": "area"}))
        place = scene(search, mesh(sphere(400) * np.float32(0.5), OneSided), lamp, mesh(sphere(3000)))
        tree = place.geometry.triangles.tree  # type: ignore[union-attr]
        assert isinstance(tree, CompiledTree)
        for lights in (Bool(False), through):
            met, blocked = (tree.search(ray, any_hit, active, lights) for any_hit in (False, True))
            assert met.b is not None
            found.append([words(x) for x in (met.t, met.record, met.b.x, met.b.y, blocked.record)])
    assert 0.2 < (found[0][1] != NONE).mean() < 0.9
    for ours, theirs in ((found[0], found[2]), (found[1], found[3])):
        hit = theirs[1] != NONE
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a[hit], b[hit])
        np.testing.assert_array_equal(ours[1], theirs[1])
        np.testing.assert_array_equal(ours[-1], theirs[-1])


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.sparse(2)
def test_solids_and_instances_are_hit_as_by_steps(search: str) -> None:
    ray, results = rays_at_village(30000), []
    for ways in (search, "steps"):
        si = village(ways).ray_intersect(ray)
        results.append([np.array(x) for x in (si.t, si.p, si.n, si.uv, si.sh_frame.n, si.shape_index, si.prim_index)])
    hit = np.isfinite(results[0][0])
    assert 0.3 < hit.mean() < 0.95
    assert np.mean(hit != np.isfinite(results[1][0])) < 1e-3
    hit &= np.isfinite(results[1][0])
    for a, b in zip(*results, strict=True):
        error = np.abs(a.astype(float) - b.astype(float))[..., hit].reshape(-1, hit.sum()).max(axis=0)
        assert np.mean(error > 2e-3) < 2e-3


@pytest.mark.parametrize("schedule", ["flat", "machine", "wave"])
@pytest.mark.sparse(4)
def test_images_are_those_of_steps(schedule: str) -> None:
    """With lights in the tree that camera rays pass through, and shadow rays don't."""
    images = []
    for ways in (FASTEST, "steps"):
        place = village(ways)
        view = {"type": "perspective", "to_world": T().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])}
        view["film"] = {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}}
        image = djpt.render(
            place,
            sensor=djpt.load_dict(view),
            integrator=djpt.load_dict({"type": "path", "max_depth": 4, "hide_emitters": True}),
            spp=8,
            schedule=schedule,
        )
        images.append(np.array(image))
    assert images[0].max() > 0
    assert np.mean(np.abs(images[0] - images[1]) < 1e-3 * (1 + images[1])) > 0.99


def closed_sphere(rows: int) -> djpt.Mesh:
    """A sphere without holes, whose triangles share vertices."""
    u = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    v = np.linspace(0, np.pi, rows + 1)[1:-1]
    ring = np.stack(
        np.broadcast_arrays(np.sin(v)[:, None] * np.cos(u), np.cos(v)[:, None], np.sin(v)[:, None] * np.sin(u)), -1
    )
    positions = np.concatenate([[[0, 1, 0]], ring.reshape(-1, 3), [[0, -1, 0]]])
    n, last = 2 * rows, len(positions) - 1
    i = np.arange(n)
    after = (i + 1) % n
    faces = [np.stack([0 * i, 1 + after, 1 + i], 1)]
    for row in range(rows - 2):
        a = 1 + row * n
        faces += [np.stack([a + i, a + after, a + n + i], 1), np.stack([a + after, a + n + after, a + n + i], 1)]
    a = 1 + (rows - 2) * n
    faces.append(np.stack([a + i, a + after, last + 0 * i], 1))
    return djpt.Mesh("closed", positions, np.concatenate(faces))


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("count", [10**5, pytest.param(10**7, marks=pytest.mark.slow)])
def test_no_ray_slips_through_edges_and_vertices(count: int, search: str) -> None:
    """Rays from inside of a closed surface, exactly at its vertices and at points of its edges."""
    ball = closed_sphere(60)
    closed, rng = scene(search, ball), np.random.default_rng(3)
    positions, faces = ball.positions.astype(np.float64), ball.indices
    for begin in range(0, count, 10**6):
        n = min(10**6, count - begin)
        o = rng.uniform(-0.4, 0.4, (n, 3))
        face, side = faces[rng.integers(0, len(faces), n)], rng.integers(0, 3, n)
        rows = np.arange(n)
        a, b = positions[face[rows, side]], positions[face[rows, (side + 1) % 3]]
        share = np.where(rng.random(n) < 0.4, 0, rng.random(n))[:, None]
        d = (a + share * (b - a)) - o
        ray = Ray3f(Point3f(*o.T), Vector3f(*d.T))
        assert np.count_nonzero(~np.array(closed.ray_test(ray))) == 0
        t = np.array(closed.ray_intersect_preliminary(ray).t)
        assert np.count_nonzero(~np.isfinite(t)) == 0
        np.testing.assert_allclose(t, 1, atol=2e-3)


def test_queries_leave_no_variables_behind(capfd: pytest.CaptureFixture[str]) -> None:
    place, ray = scene(FASTEST, mesh(sphere(500))), rays_at(sphere(500), 100)

    def variables() -> int:
        gc.collect()
        capfd.readouterr()
        dr.whos()
        return len(capfd.readouterr().out.splitlines())

    def query() -> None:
        dr.eval(place.ray_intersect(ray), place.ray_test(ray))

    query()
    before = variables()
    assert before > 10
    for _ in range(5):
        query()
    assert variables() <= before


def test_an_edit_leaves_earlier_queries_alone() -> None:
    """What was asked before an edit, but isn't computed yet, is answered by the old geometry."""
    place = scene(FASTEST, mesh(sphere(500)))
    params = djpt.traverse(place)
    key = next(k for k in params if k.endswith("vertex_positions"))
    ray = Ray3f(Point3f(0, 0, 5), Vector3f(0, 0, -1))
    before = place.ray_intersect_preliminary(ray).t
    params[key] = np.array(params[key]) + 0.5
    params.update()
    after = place.ray_intersect_preliminary(ray).t
    expected = np.array(scene("steps", mesh(sphere(500))).ray_intersect_preliminary(ray).t)
    np.testing.assert_allclose(np.array(before), expected, rtol=1e-5)
    assert abs(float(after[0]) - float(before[0])) > 0.1


def test_edits_compile_nothing() -> None:
    place = scene(FASTEST, mesh(sphere(500)), sky={"type": "constant"})
    params = djpt.traverse(place)
    key = next(k for k in params if k.endswith("vertex_positions"))
    view = djpt.load_dict({"type": "perspective", "film": {"type": "hdrfilm", "width": 8, "height": 8}})
    djpt.render(place, sensor=view, spp=4)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        params[key] = np.array(params[key]) * 0.9
        params.update()
        djpt.render(place, sensor=view, spp=4, seed=1)
    kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    assert kernels
    assert all(k["cache_hit"] for k in kernels)


def test_frozen_queries() -> None:
    """Arrays that were made before must be named, as for all frozen functions."""
    place, corners = scene(FASTEST, mesh(sphere(500))), sphere(500)
    assert place.geometry.triangles is not None
    geometry, tree = place.geometry, place.geometry.triangles.tree
    assert isinstance(tree, CompiledTree)
    used = (tree.memory, tree.functions.closest.memory, tree.center, tree.radius, geometry._low, geometry._high)

    @dr.freeze(state_fn=lambda *_: used)
    def hits(o: Point3f, d: Vector3f) -> Float:
        return place.ray_intersect_preliminary(Ray3f(o, d)).t

    for seed in range(3):
        ray = rays_at(corners, 1000, seed)
        expected = np.array(place.ray_intersect_preliminary(Ray3f(ray.o, ray.d)).t)
        np.testing.assert_array_equal(np.array(hits(ray.o, ray.d)), expected)


def test_masked_queries_answer_no() -> None:
    corners = sphere(500)
    place, ray = scene(FASTEST, mesh(corners)), rays_at(corners, 1000)
    active = dr.arange(UInt32, 1000) % 3 != 0
    hit = np.array(place.ray_test(ray))
    np.testing.assert_array_equal(np.array(place.ray_test(ray, active)), hit & np.array(active))


# ---- the choice ----------------------------------------------------------------------------------------------


def is_called(place: djpt.Scene) -> bool:
    assert place.geometry.triangles is not None
    return isinstance(place.geometry.triangles.tree, CompiledTree)


def test_either_way_can_be_forced(monkeypatch: pytest.MonkeyPatch) -> None:
    for ways in (*SEARCHES, "steps"):
        monkeypatch.setenv(engines.VARIABLE, ways)
        assert chosen() == ways
        assert is_called(djpt.load_dict({"type": "scene", "m": mesh(sphere(30))})) == (ways != "steps")
    with ray_queries("call"):
        assert chosen() == "call"
    monkeypatch.setenv(engines.VARIABLE, "auto")
    assert chosen() == FASTEST
    monkeypatch.setenv(engines.VARIABLE, "cal")
    with pytest.raises(SceneError, match=r"unknown way of ray queries 'cal'; did you mean 'call'"):
        chosen()
    with pytest.raises(SceneError, match="unknown way of ray queries"), ray_queries("stepwise"):
        pass


def test_what_fails_its_test_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(engines.VARIABLE, raising=False)
    right = searches.call_any
    monkeypatch.setattr(searches, "call_any", lambda *arguments: ~right(*arguments))
    assert not any(searches.proof.__wrapped__(search).hits for search in SEARCHES)
    monkeypatch.setattr(engines, "why_not", lambda _: "rays with known hits got other results")
    assert chosen() == "steps"
    assert not is_called(scene("auto", mesh(sphere(30))))
    with pytest.raises(SceneError, match=r"don't work: rays with known hits got other results; possible: steps"):
        scene("call", mesh(sphere(30)))


def test_a_missing_function_of_the_core_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: Any) -> Bool:
        raise CallError("this version of Dr.Jit has no calls of functions")

    monkeypatch.setattr(searches, "call_closest", missing)
    for kept in (searches.why_not, searches.proof):
        kept.cache_clear()
    try:
        assert searches.why_not("call") == "this version of Dr.Jit has no calls of functions"
    finally:
        searches.why_not.cache_clear()
