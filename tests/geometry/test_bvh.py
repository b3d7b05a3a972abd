"""Trees: whole, good, quickly built, the same each time; and refitted."""

from __future__ import annotations

import functools
import itertools
import platform
import subprocess
import sys
import time

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

from djpt.geometry.bvh.build import binary
from djpt.geometry.bvh.build.binary import BinaryTree, Method, build, half_area
from djpt.geometry.bvh.build.wide import REBUILD, WideTree, child_leaf, collapse, grown, refit, sah_cost
from tests.kit.processes import ROOT
from tests.kit.triangle_soups import SOUPS, exponential, giants_among_dwarfs, sphere

pytestmark = pytest.mark.narrow

METHODS: list[Method] = ["sah", "median", "longest_axis"]


def boxes(corners: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return corners.min(axis=1), corners.max(axis=1)


def tree_of(corners: NDArray[np.float32], method: Method = "sah") -> BinaryTree:
    return build(*boxes(corners), method)


def wide_of(corners: NDArray[np.float32], width: int = 4) -> WideTree:
    return collapse(tree_of(corners), width)


# ---------------------------------------------------------------- whole


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SOUPS)
def test_every_primitive_is_in_one_leaf_and_every_box_fits_tightly(name: str, method: Method) -> None:
    low, high = boxes(SOUPS[name]())
    tree = build(low, high, method)
    inner, leaf = np.flatnonzero(tree.left >= 0), np.flatnonzero(tree.left < 0)
    left = tree.left[inner]
    assert len(tree.box) == len(tree.left) == len(tree.primitive) == 2 * len(low) - 1
    np.testing.assert_array_equal(np.sort(tree.primitive[leaf]), np.arange(len(low)))
    assert (tree.primitive[inner] == -1).all()
    assert (left > inner).all()
    np.testing.assert_array_equal(np.sort(np.concatenate([left, left + 1])), np.arange(1, len(tree.left)))
    np.testing.assert_array_equal(tree.box[leaf, :3], low[tree.primitive[leaf]])
    np.testing.assert_array_equal(tree.box[leaf, 3:], high[tree.primitive[leaf]])
    np.testing.assert_array_equal(tree.box[inner, :3], np.minimum(tree.box[left, :3], tree.box[left + 1, :3]))
    np.testing.assert_array_equal(tree.box[inner, 3:], np.maximum(tree.box[left, 3:], tree.box[left + 1, 3:]))


@pytest.mark.parametrize("width", [2, 4, 8])
@pytest.mark.parametrize("name", SOUPS)
@pytest.mark.sparse(12)
def test_a_wide_tree_holds_the_same_leaves_in_depth_first_order(name: str, width: int) -> None:
    low, high = boxes(SOUPS[name]())
    tree = collapse(build(low, high), width)
    visited, deepest = [], 0

    def visit(node: int, depth: int) -> NDArray[np.float32]:
        nonlocal deepest
        assert node == len(visited), "not in depth-first order"
        visited.append(node)
        deepest = max(deepest, depth)
        present = tree.child[node] != -1
        assert not (present[1:] & ~present[:-1]).any(), "a gap between children"
        assert (tree.box[node, ~present] == 0).all()
        for child, box in zip(tree.child[node, present], tree.box[node, present], strict=True):
            primitive = child_leaf(child)
            inside = visit(child, depth + 1) if child >= 0 else np.concatenate([low[primitive], high[primitive]])
            np.testing.assert_array_equal(box, inside)
        own = tree.box[node, present]
        return np.concatenate([own[:, :3].min(axis=0), own[:, 3:].max(axis=0)])

    visit(0, 1)
    assert len(visited) == len(tree.child)
    assert deepest == tree.depth
    np.testing.assert_array_equal(np.sort(child_leaf(tree.child[tree.child < -1])), np.arange(len(low)))


@pytest.mark.parametrize("odd", [np.nan, np.inf, 3e38, 1e25, 1e-40])
@pytest.mark.filterwarnings("ignore:(overflow|invalid):RuntimeWarning")
def test_odd_numbers_still_make_a_whole_tree(odd: float) -> None:
    low, high = boxes(np.concatenate([SOUPS["scattered"](), sphere(100)]))
    for scaled in (False, True):
        some = slice(None) if scaled and np.isfinite(odd) else slice(0, None, 17)
        low[some], high[some] = low[some] * np.float32(odd), high[some] * np.float32(odd)
        for method in METHODS:
            tree = build(low, high, method)
            np.testing.assert_array_equal(np.sort(tree.primitive[tree.left < 0]), np.arange(len(low)))
            assert len(np.unique(child_leaf(collapse(tree).child)[collapse(tree).child < -1])) == len(low)


# ---------------------------------------------------------------- good


def reference_cost(low: NDArray[np.float32], high: NDArray[np.float32]) -> float:
    """The SAH cost of a plain recursive builder: 16 bins on each axis, all primitives, double precision."""
    low, high = low.astype(np.float64), high.astype(np.float64)
    center = low + high
    total = 0.0

    def area_from(order: NDArray[np.intp]) -> NDArray[np.float64]:
        lo, hi = np.minimum.accumulate(low[order]), np.maximum.accumulate(high[order])
        return half_area(np.concatenate([lo, hi], axis=1))

    stack = [np.arange(len(low))]
    while stack:
        part = stack.pop()
        total += float(half_area(np.concatenate([low[part].min(axis=0), high[part].max(axis=0)])))
        if len(part) == 1:
            continue
        best: tuple[float, list[NDArray[np.intp]]] = (np.inf, np.array_split(part, 2))
        for axis in range(3):
            c = center[part, axis]
            extent = c.max() - c.min()
            if extent == 0:
                continue
            order = part[np.argsort(c, kind="stable")]
            left, right = area_from(order)[:-1], area_from(order[::-1])[::-1][1:]
            count = np.arange(1, len(part))
            ordered = (center[order, axis] - c.min()) / extent * 15.9999
            between_bins = np.floor(ordered[1:]) > np.floor(ordered[:-1])
            cost = np.where(between_bins, left * count + right * count[::-1], np.inf)
            k = int(cost.argmin())
            if cost[k] < best[0]:
                best = cost[k], [order[: k + 1], order[k + 1 :]]
        stack += best[1]
    return total / float(half_area(np.concatenate([low.min(axis=0), high.max(axis=0)])))


@pytest.mark.parametrize("name", ["scattered", "sphere", "giants_among_dwarfs", "far_away"])
@pytest.mark.sparse(4)
def test_the_sah_tree_is_as_good_as_a_plain_binned_one(name: str) -> None:
    corners = SOUPS[name]()
    assert sah_cost(tree_of(corners)) < 1.02 * reference_cost(*boxes(corners))


def test_better_methods_make_cheaper_trees() -> None:
    corners = giants_among_dwarfs()
    sah, longest, median = (sah_cost(tree_of(corners, m)) for m in ("sah", "longest_axis", "median"))
    assert sah < 0.9 * longest
    assert longest < 0.9 * median


def test_without_compiled_functions_trees_are_cut_halfway(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = giants_among_dwarfs()
    compiled, halfway = tree_of(corners), tree_of(corners, "longest_axis")
    monkeypatch.setattr(binary, "can_compile", lambda: False)
    found = tree_of(corners)
    np.testing.assert_array_equal(found.left, halfway.left)
    np.testing.assert_array_equal(found.primitive, halfway.primitive)
    assert sah_cost(compiled) < 0.9 * sah_cost(found)


def test_a_floor_is_split_off_at_the_root() -> None:
    corners = giants_among_dwarfs()
    tree = tree_of(corners)
    giants = [len(corners) - 2, len(corners) - 1]
    near_root = set(tree.primitive[:15])
    assert near_root.issuperset(giants)


@pytest.mark.slow
def test_the_cost_is_what_random_lines_meet() -> None:
    """Lines with uniform directions and offsets that meet the root's box."""
    tree = wide_of(sphere(100))
    present = tree.box[tree.child != -1]
    rng = np.random.default_rng(3)
    d = rng.normal(size=(200_000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # A disc across the direction that hides the whole object.
    across = np.cross(d, [0.6, 0.0, 0.8])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    radius, angle = 2.2 * np.sqrt(rng.random((2, len(d)))[0]), 2 * np.pi * rng.random(len(d))
    o = radius[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(d, across))

    def met(box: NDArray[np.float32]) -> NDArray[np.bool_]:
        a, b = (box[:3] - o) / d, (box[3:] - o) / d
        return np.asarray(np.minimum(a, b).max(axis=1) <= np.maximum(a, b).min(axis=1))

    root = np.concatenate([present[:, :3].min(axis=0), present[:, 3:].max(axis=0)])
    lines = met(root)
    o, d = o[lines], d[lines]
    counted = 1 + sum(met(box).mean() for box in present)
    assert counted == pytest.approx(sah_cost(tree), rel=0.02)


def test_no_other_choice_of_nodes_makes_a_cheaper_wide_tree() -> None:
    tree = tree_of(SOUPS["scattered"]()[:14])
    area = half_area(tree.box.astype(np.float64))

    def frontiers(node: int, most: int) -> list[tuple[int, ...]]:
        """All sets of up to `most` nodes that stand for a subtree."""
        result = [(node,)]
        if tree.left[node] >= 0:
            result += pairs(node, most)
        return result

    def pairs(node: int, most: int) -> list[tuple[int, ...]]:
        left, right = (frontiers(tree.left[node] + side, most - 1) for side in range(2))
        return [a + b for a, b in itertools.product(left, right) if len(a) + len(b) <= most]

    @functools.cache
    def cheapest(node: int, width: int) -> float:
        """Surfaces of all boxes below a wide node."""
        if tree.left[node] < 0:
            return 0.0
        return min(sum(area[n] + cheapest(n, width) for n in f) for f in pairs(node, width))

    for width in (2, 3, 4, 5):
        wide = collapse(tree, width)
        assert half_area(wide.box[wide.child != -1]).sum() == pytest.approx(cheapest(0, width), rel=1e-5)


def test_skewed_input_doesnt_make_a_deep_tree() -> None:
    corners = np.tile(exponential(), (8, 1, 1))
    corners[:, 0] += np.linspace(0, 1e-3, len(corners), dtype=np.float32)[:, None]
    depth = wide_of(corners, 2).depth
    assert depth <= 2 * np.ceil(np.log2(len(corners))) + 12


# ---------------------------------------------------------------- the same each time


def test_the_number_of_threads_doesnt_change_the_tree() -> None:
    low, high = boxes(sphere(30000))
    threads = dr.thread_count()
    trees = []
    try:
        for count in (1, 2):
            dr.set_thread_count(count)
            trees.append(build(low, high))
    finally:
        dr.set_thread_count(threads)
    np.testing.assert_array_equal(trees[0].left, trees[1].left)
    np.testing.assert_array_equal(trees[0].primitive, trees[1].primitive)


def test_a_build_runs_no_kernels() -> None:
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        tree_of(sphere(5000))
        tree_of(SOUPS["scattered"]())
        tree_of(giants_among_dwarfs())
    assert not [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]


# ---------------------------------------------------------------- refitted


@pytest.mark.parametrize("name", SOUPS)
def test_refitting_boxes_that_stay_changes_nothing(name: str) -> None:
    low, high = boxes(SOUPS[name]())
    tree = collapse(build(low, high))
    again = refit(tree, low, high)
    np.testing.assert_array_equal(again.box, tree.box)
    np.testing.assert_array_equal(again.child, tree.child)


def test_refitted_boxes_are_those_of_the_moved_primitives() -> None:
    corners = sphere(1000)
    moved = corners + 0.2 * np.sin(9 * corners[:, :, ::-1])
    low, high = boxes(moved)
    tree = refit(wide_of(corners), low, high)

    def check(node: int) -> NDArray[np.float32]:
        for child, box in zip(tree.child[node], tree.box[node], strict=True):
            if child >= 0:
                np.testing.assert_array_equal(box, check(child))
            elif child < -1:
                np.testing.assert_array_equal(box, np.concatenate([low[child_leaf(child)], high[child_leaf(child)]]))
        own = tree.box[node, tree.child[node] != -1]
        return np.concatenate([own[:, :3].min(axis=0), own[:, 3:].max(axis=0)])

    check(0)


def test_growth_says_when_to_build_again() -> None:
    corners = sphere(4000)
    tree = wide_of(corners)
    cost = sah_cost(tree)
    assert grown(tree, cost) == 1
    bent = corners + 0.02 * np.sin(3 * corners[:, :, ::-1])
    assert grown(refit(tree, *boxes(bent)), cost) < 1.1
    shuffled = np.random.default_rng(1).permutation(corners)
    assert grown(refit(tree, *boxes(shuffled)), cost) > 10 * REBUILD


# ---------------------------------------------------------------- quickly built

MILLION = """
import time, djpt
from djpt.geometry.bvh.build.binary import build
from djpt.geometry.bvh.build.wide import collapse
from tests.kit.triangle_soups import sphere

def kilobytes(what):
    return int(open("/proc/self/status").read().split(what + ":")[1].split()[0])

corners = sphere(1_000_000)
low, high = corners.min(axis=1), corners.max(axis=1)
open("/proc/self/clear_refs", "w").write("5")
before = kilobytes("VmRSS")
clocks = time.perf_counter, time.process_time
starts = [clock() for clock in clocks]
collapse(build(low, high))
# Other processes of a busy machine prolong the first; several threads of this one add up in the second.
seconds = min(clock() - start for clock, start in zip(clocks, starts))
print(seconds, (kilobytes("VmHWM") - before) / 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads peak memory from /proc")
def test_a_million_triangles_take_three_seconds_and_300_mebibytes() -> None:
    result = subprocess.run([sys.executable, "-c", MILLION], capture_output=True, text=True, check=True, cwd=ROOT)
    seconds, mebibytes = (float(word) for word in result.stdout.split())
    assert seconds < 3
    assert mebibytes < 300


@pytest.mark.skipif(platform.machine() != "x86_64", reason="measured on x86-64; others may be emulated")
def test_a_hundred_thousand_triangles_take_less_than_a_second() -> None:
    low, high = boxes(sphere(100_000))
    start = time.process_time()
    collapse(build(low, high))
    assert time.process_time() - start < 1
