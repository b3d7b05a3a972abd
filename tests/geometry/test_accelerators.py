"""The BVHs, the grid, the octree, the kd-tree, the BSP tree and brute force answer the same, and answer right."""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from djpt.core.records import Ray3f
from djpt.geometry.accelerators.base import Accelerator, Approach
from djpt.geometry.accelerators.brute_force import BruteForce, closest_in_double
from djpt.geometry.accelerators.bsp import BspTree, clip
from djpt.geometry.accelerators.bvh import Bvh
from djpt.geometry.accelerators.grid import UniformGrid
from djpt.geometry.accelerators.kdtree import KdTree
from djpt.geometry.accelerators.octree import Octree, overlap
from djpt.geometry.accelerators.simple_bvh import SimpleBvh
from djpt.jit.types import Float, Point3f, UInt32, Vector3f
from tests.kit.arrays import floats, rows
from tests.kit.processes import ROOT, run_python
from tests.kit.triangle_soups import SOUPS, scattered, sphere

KINDS = {
    "bvh": Bvh,
    "plain bvh": partial(Bvh, method="longest_axis"),
    "simple bvh": SimpleBvh,
    "grid": UniformGrid,
    "octree": Octree,
    "kd-tree": KdTree,
    "bsp tree": BspTree,
}


def rays_at(corners: NDArray[np.float32], count: int, seed: int = 0) -> tuple[NDArray[np.float32], ...]:
    """Origins and directions: from within and without, along axes, from surfaces, from far away."""
    rng = np.random.default_rng(seed)
    low, high = corners.min(axis=(0, 1)).astype(np.float64), corners.max(axis=(0, 1)).astype(np.float64)
    middle, extent = (low + high) / 2, np.linalg.norm(high - low)
    target = corners[rng.integers(len(corners), size=count)].mean(axis=1) + 0.02 * extent * rng.normal(size=(count, 3))
    o = middle + extent * rng.uniform(-0.8, 0.8, (count, 3))
    part = count // 8
    o[:part] = middle + 100 * extent * rng.normal(size=(part, 3))
    d = target - o
    d[part : 2 * part] = np.eye(3)[rng.integers(3, size=part)] * rng.choice([-1, 1], (part, 1))
    o[part : 2 * part] = target[part : 2 * part] - d[part : 2 * part] * extent
    d[2 * part : 3 * part, 1] = 0
    # Starting on a triangle, and within the plane of its corner.
    o[3 * part : 4 * part] = corners[rng.integers(len(corners), size=part)].mean(axis=1)
    o[4 * part : 5 * part] = corners[rng.integers(len(corners), size=part), 0]
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-30)
    return o.astype(np.float32), d.astype(np.float32)


def ray_of(o: NDArray[np.float32], d: NDArray[np.float32], maxt: Any = np.inf) -> Ray3f:
    return Ray3f(Point3f(*rows(o.T)), Vector3f(*rows(d.T)), maxt=floats(maxt) if np.ndim(maxt) else Float(maxt))


def answers(structure: Accelerator, ray: Ray3f) -> tuple[NDArray[Any], ...]:
    (t, face), any_hit = structure.closest(ray), structure.any_hit(ray)
    dr.eval(t, face, any_hit)
    return t.numpy(), face.numpy(), any_hit.numpy()


@pytest.mark.sparse(36)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SOUPS)
def test_all_structures_find_the_hits_of_brute_force(name: str, kind: str) -> None:
    corners = SOUPS[name]()
    o, d = rays_at(corners, 800)
    rng = np.random.default_rng(1)
    extent = np.linalg.norm(corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)))
    for maxt in (np.inf, (extent * rng.uniform(0, 1, len(o))).astype(np.float32)):
        ray = ray_of(o, d, maxt)
        brute = BruteForce(corners)
        t, _, any_hit = answers(brute, ray)
        t_too, face_too, any_too = answers(KINDS[kind](corners), ray)
        np.testing.assert_array_equal(t_too, t)
        np.testing.assert_array_equal(any_too, any_hit)
        np.testing.assert_array_equal(any_hit, np.isfinite(t))
        assert (face_too[~any_hit] == 0).all()
        # Where several triangles are hit at one distance, any of them is right.
        approach = Approach(brute.table, ray)
        own = brute.table.visit(approach, UInt32(face_too), approach.nothing_yet())
        np.testing.assert_array_equal((own.t + approach.entry).numpy()[any_hit], t[any_hit])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scattered", "crowd", "sphere", "giants_among_dwarfs", "flat", "far_away"])
def test_a_hundred_thousand_rays_have_the_hits_of_brute_force(name: str) -> None:
    corners = scattered(2000, seed=8) if name == "crowd" else SOUPS[name]()
    o, d = rays_at(corners, 110_000, seed=5)
    # A ray towards a triangle that shrinks to its own origin has no direction.
    good = np.flatnonzero(np.linalg.norm(d, axis=1) > 0.5)[:100_000]
    assert len(good) == 100_000
    ray = ray_of(o[good], d[good])
    t, _, any_hit = answers(BruteForce(corners), ray)
    assert 0.1 < any_hit.mean() < 1
    for kind in ("simple bvh", "grid", "octree", "kd-tree", "bsp tree"):
        t_too, _, any_too = answers(KINDS[kind](corners), ray)
        np.testing.assert_array_equal(t_too, t, err_msg=kind)
        np.testing.assert_array_equal(any_too, any_hit, err_msg=kind)


@pytest.mark.parametrize("corners", [SOUPS["scattered"](), sphere(400)], ids=["scattered", "sphere"])
@pytest.mark.sparse(2)
def test_cells_of_the_bsp_tree_fill_the_box_and_know_their_triangles(corners: NDArray[np.float32]) -> None:
    tree = BspTree(corners)
    leaves = tree.leaves()
    rng = np.random.default_rng(3)
    points = rng.uniform(tree.low, tree.high, (300, 3))
    faces = rng.integers(len(corners), size=300)
    weights = rng.dirichlet(np.ones(3), 300)
    center = tree.table.center.numpy().ravel().astype(np.float64)
    on_faces = np.einsum("pk,pka->pa", weights, corners[faces].astype(np.float64)) - center
    inside, listed = np.zeros(300, int), np.zeros(300, bool)
    for cell, own in leaves:
        inside += (points @ cell[:, :3].T <= cell[:, 3]).all(axis=1)
        listed |= (on_faces @ cell[:, :3].T <= cell[:, 3]).all(axis=1) & np.isin(faces, own)
    np.testing.assert_array_equal(inside, 1)
    assert listed.all()
    # Of the planes many are neither across an axis nor the same.
    normals = np.concatenate([cell[6:, :3] for cell, _ in leaves])
    assert (np.abs(normals).max(axis=1) < 0.99).mean() > 0.2


def test_polygons_are_cut_at_the_plane() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0]], np.float64)
    for at, area in ((0.25, 0.25), (1.0, 1.0), (0.5, 0.5)):
        (part,) = clip(square[None], square[None, :, 0] - at)
        x, y = part[:, 0], part[:, 1]
        np.testing.assert_allclose(0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))), area)
    corner = square[None] @ np.array([1.0, 1, 0]) - 1.5
    (part,) = clip(square[None], corner)
    assert len(np.unique(part, axis=0)) == 5


def test_triangles_overlap_boxes_that_they_cut() -> None:
    rng = np.random.default_rng(4)
    corners = rng.uniform(-1, 2, (500, 3, 3)) * [1, 1, 0.3] + rng.uniform(-1, 1, (500, 1, 3))
    low, high = np.zeros((500, 3), np.float32), np.ones((500, 3), np.float32)
    bounds = ((corners.min(axis=1) <= 1) & (corners.max(axis=1) >= 0)).all(axis=1)
    found = bounds & overlap(corners, low, high, 0.0)
    weights = rng.dirichlet(np.full(3, 0.7), 6000)
    points = np.einsum("wk,pka->pwa", weights, corners)
    seen = ((points >= 0) & (points <= 1)).all(axis=2).any(axis=1)
    assert not (seen & ~found).any()
    # Points miss small corners of triangles, no more.
    assert (found & ~seen).sum() < 0.03 * found.sum()
    assert found.sum() < 0.9 * bounds.sum()


@pytest.mark.parametrize("name", ["scattered", "sphere", "giants_among_dwarfs", "far_away"])
@pytest.mark.sparse(4)
def test_brute_force_finds_the_hits_of_double_precision(name: str) -> None:
    corners = SOUPS[name]()
    o, d = rays_at(corners, 800)
    part = len(o) // 8
    clear = np.ones(len(o), np.bool_)
    clear[3 * part : 5 * part] = False  # origins on triangles are on either side of them, by rounding
    o, d = o[clear], d[clear]
    t, face, _ = answers(BruteForce(corners), ray_of(o, d))
    exact, exact_face, margin = closest_in_double(corners, o, d)
    certain = margin > 1e-4
    assert certain.mean() > 0.5
    np.testing.assert_array_equal(np.isfinite(t)[certain], np.isfinite(exact)[certain])
    both = certain & np.isfinite(t)
    assert both.sum() > 100
    extent = np.linalg.norm(corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)))
    np.testing.assert_allclose(t[both], exact[both], rtol=2e-5, atol=2e-5 * extent)
    assert (face == exact_face)[both].mean() > 0.99


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), flat=st.integers(-1, 2), snap=st.booleans())
@pytest.mark.slow
def test_structures_agree_on_whatever_triangles(seed: int, count: int, flat: int, snap: bool) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 3, 3)) * 10 ** rng.uniform(-2, 2, (count, 1, 1))
    if snap:  # onto a lattice: many equal coordinates, planes through edges
        corners = np.round(corners)
    if flat >= 0:
        corners[:, :, flat] = 0
    corners = corners.astype(np.float32)
    o, d = rays_at(corners, 64, seed)
    good = np.linalg.norm(d, axis=1) > 0.5
    ray = ray_of(o[good], d[good])
    t = answers(BruteForce(corners), ray)[0]
    for kind, structure in KINDS.items():
        t_too, _, any_too = answers(structure(corners), ray)
        np.testing.assert_array_equal(t_too, t, err_msg=kind)
        np.testing.assert_array_equal(any_too, np.isfinite(t), err_msg=kind)


@pytest.mark.slow
def test_no_ray_slips_through_a_closed_surface() -> None:
    """From the middle of a sphere, exactly at its vertices and edges."""
    corners = sphere(2000, bumps=0.0)
    edges = np.concatenate([corners.reshape(-1, 3), (corners[:, 0] + corners[:, 1]) / 2, corners.mean(axis=1)])
    edges = edges[np.abs(edges[:, 2]) < 0.99]  # its poles are open
    ray = ray_of(np.zeros_like(edges), edges)
    for kind, structure in {**KINDS, "brute force": BruteForce}.items():
        assert np.isfinite(structure(corners).closest(ray)[0].numpy()).all(), kind


@pytest.mark.parametrize("kind", [*KINDS, "brute force"])
@pytest.mark.sparse(4)
def test_statistics_describe_the_structure(kind: str) -> None:
    corners = sphere(2000)
    statistics = {**KINDS, "brute force": BruteForce}[kind](corners).statistics()
    assert statistics.primitives == len(corners)
    assert statistics.references >= len(corners)
    assert statistics.bytes >= 64 * len(corners)
    assert statistics.build_seconds > 0
    assert f"{len(corners)} primitives" in str(statistics)
    if kind != "brute force":
        # All save most of the work.
        assert 1 < statistics.sah_cost < len(corners) / 20


def test_a_large_triangle_doesnt_fill_the_memory_of_a_fine_grid() -> None:
    corners = np.concatenate([sphere(4000), [[[-9, -9, -9], [9, 9, -9], [9, 9, 9]]]]).astype(np.float32)
    corners = np.concatenate([corners, np.repeat(corners[-1:], 500, axis=0)])
    assert UniformGrid(corners).references < 20 * len(corners)


def test_queries_work_in_a_kernel_with_one_ray() -> None:
    corners = sphere(500)
    ray = ray_of(np.array([[0, 0, 0]], np.float32), np.array([[1, 0, 0]], np.float32))
    expected = BruteForce(corners).closest(ray)[0].numpy()
    for structure in KINDS.values():
        t, _ = structure(corners).closest(ray)
        assert dr.width(t) == 1
        np.testing.assert_array_equal(t.numpy(), expected)


@pytest.mark.slow
def test_the_benchmark_runs() -> None:
    pytest.importorskip("mitsuba")
    options = ["--triangles", "500", "--rays", "2000", "--rounds", "1", "--all"]
    done = run_python(str(ROOT / "benchmarks" / "accelerators.py"), *options)
    assert done.returncode == 0, done.stderr
    names = [line.split("  ")[0] for line in done.stdout.splitlines()[-10:]]
    trees = ["BVH", "BVH, longest_axis", "BVH, median", "simple BVH", "grid", "octree", "kd-tree", "BSP tree"]
    assert names == ["Mitsuba", *trees, "brute force"]
