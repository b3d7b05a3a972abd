"""Trees that machine code builds: whole, good, the same with any number of threads; and fitted again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from djpt.geometry.bvh.build.binary import build as build_binary
from djpt.geometry.bvh.build.binary import half_area
from djpt.geometry.bvh.build.builder import DEEPEST, Built, build, refit
from djpt.geometry.bvh.build.wide import collapse, sah_cost
from tests.kit.triangle_soups import SOUPS, sphere

Floats = NDArray[np.float32]

LEAF, PLACED, NUMBER = 0x80000000, 0xC0000000, 0x3FFFFFFF
ROOT, NODE, BLOCK = 8, 8, 10


def nested(count: int) -> Floats:
    """Triangles of size 1, 1/2, 1/4 ... from one corner."""
    return np.array([[[0, 0, 0], [1, 0, 0.3], [0, 1, 0.5]]] * count, np.float32) * (
        np.float32(0.5) ** (np.arange(count) % 100)
    )[:, None, None].astype(np.float32)


CASES = {
    **SOUPS,
    "nine": lambda: SOUPS["copies"]()[:9],
    "points": lambda: np.repeat(np.random.default_rng(0).normal(size=(100, 1, 3)), 3, axis=1).astype(np.float32),
    "one_point": lambda: np.zeros((40, 3, 3), np.float32),
    "line": lambda: np.arange(300, dtype=np.float32).reshape(100, 3, 1) * np.float32([1, 0, 0]),
    "nested": lambda: nested(400),
    "tiny": lambda: sphere(500) * np.float32(1e-12),
    "huge": lambda: sphere(500) * np.float32(1e12),
}


def boxes_of(count: int, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    low = rng.uniform(-1, 1, (count, 3))
    return np.concatenate([low, low + rng.uniform(0, 0.3, (count, 3))], axis=1).astype(np.float32)


def rows(tree: Built) -> tuple[Floats, NDArray[np.uint32]]:
    words = tree.memory.reshape(-1, 8)
    return words.view(np.float32), words


def check(tree: Built, corners: Floats, placed: Floats) -> None:
    """Walk through a tree from the root, and compare all that is found with the input."""
    floats, words = rows(tree)
    assert tree.memory.ctypes.data % 64 == 0
    assert len(words) == ROOT + NODE * tree.nodes + BLOCK * tree.leaves
    np.testing.assert_array_equal(np.sort(tree.order), np.arange(len(corners)))
    low, high = (np.concatenate([c, p]) for c, p in zip(bounds(corners), (placed[:, :3], placed[:, 3:]), strict=True))
    center = ((low.min(axis=0).astype(np.float64) + high.max(axis=0)) / 2).astype(np.float32)
    np.testing.assert_array_equal(tree.extent.center, center)
    diagonal = float(np.linalg.norm(high.max(axis=0).astype(np.float64) - low.min(axis=0)))
    assert tree.extent.diagonal == pytest.approx(diagonal)
    slack = np.float32(4e-7 * max(diagonal, 1e-30))

    records: list[int] = []
    numbers: list[int] = []
    blocks: list[int] = []
    nodes: list[int] = []
    areas = np.zeros(2)

    def visit(unit: int, level: int) -> tuple[Floats, Floats]:
        assert (unit - ROOT) % NODE == 0 and unit < ROOT + NODE * tree.nodes and level <= tree.depth
        nodes.append(unit)
        references = words[unit + 6]
        count = int((references != 0).sum())
        assert count > 0 and (references[:count] != 0).all() and not words[unit + 7].any()
        planes = floats[unit : unit + 6].reshape(3, 2, 8)
        assert (planes[:, 0, count:] == np.float32(1e30)).all() and (planes[:, 1, count:] == np.float32(-1e30)).all()
        for slot, reference in enumerate(references[:count].tolist()):
            if reference < LEAF:
                assert reference > unit
                box = visit(reference, level + 1)
            elif reference < PLACED:
                box = block(reference ^ LEAF)
            else:
                numbers.append(reference & NUMBER)
                own = placed[numbers[-1]]
                box = own[:3] - center - slack, own[3:] - center + slack
            np.testing.assert_array_equal(planes[:, 0, slot], box[0])
            np.testing.assert_array_equal(planes[:, 1, slot], box[1])
            x, y, z = (box[1] - box[0]).astype(np.float64)
            areas[int(reference >= LEAF)] += x * y + y * z + z * x
        return planes[:, 0].min(axis=1), planes[:, 1].max(axis=1)

    def block(unit: int) -> tuple[Floats, Floats]:
        assert (unit - ROOT - NODE * tree.nodes) % BLOCK == 0
        blocks.append(unit)
        points, own = floats[unit : unit + 9], words[unit + 9]
        used = ~np.isnan(points[0])
        count = int(used.sum())
        assert count > 0 and used[:count].all()
        assert np.isnan(points[:, count:]).all() and not np.isnan(points[:, :count]).any()
        np.testing.assert_array_equal(own[:count], own[0] + np.arange(count))
        np.testing.assert_array_equal(own[count:], own[0])
        records.extend(own[:count].tolist())
        triangles = corners[tree.order[own[:count]]] - center
        np.testing.assert_array_equal(points[:, :count], triangles.reshape(-1, 9).T)
        return triangles.min(axis=(0, 1)) - slack, triangles.max(axis=(0, 1)) + slack

    visit(ROOT, 1)
    assert sorted(records) == list(range(len(corners)))
    assert len(set(blocks)) == len(blocks) == tree.leaves
    assert nodes == list(range(ROOT, ROOT + NODE * tree.nodes, NODE))
    assert sorted(numbers) == list(range(len(placed)))
    x, y, z = (high.max(axis=0) - low.min(axis=0)).astype(np.float64)
    area = x * y + y * z + z * x
    if area > 0:
        assert tree.node_visits == pytest.approx(1 + areas[0] / area, rel=1e-4)
        assert tree.leaf_visits == pytest.approx(areas[1] / area, rel=1e-4)
    else:
        assert tree.sah_cost == 0


def bounds(corners: Floats) -> tuple[Floats, Floats]:
    return corners.min(axis=1), corners.max(axis=1)


NOTHING = np.zeros((0, 6), np.float32)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.sparse(4)
def test_trees_hold_every_triangle_once_in_boxes_that_fit(name: str) -> None:
    corners = np.ascontiguousarray(CASES[name]())
    tree = build(corners)
    check(tree, corners, NOTHING)
    assert tree.depth <= DEEPEST


@pytest.mark.parametrize(("triangles", "placed"), [(0, 1), (0, 50), (1, 1), (300, 7), (5, 300)])
def test_placed_primitives_are_alone_among_triangles(triangles: int, placed: int) -> None:
    corners = np.ascontiguousarray(SOUPS["scattered"]()[:triangles])
    boxes = boxes_of(placed)
    tree = build(corners, boxes)
    check(tree, corners, boxes)


@pytest.mark.parametrize("count", [3000, 60_000])
@pytest.mark.sparse(2)
def test_trees_are_the_same_with_any_number_of_threads(count: int) -> None:
    corners, boxes = sphere(count), boxes_of(20)
    first, *others = (build(corners, boxes, threads) for threads in (1, 2, 4))
    for tree in others:
        np.testing.assert_array_equal(tree.memory, first.memory)
        np.testing.assert_array_equal(tree.order, first.order)
        assert tree.sah_cost == first.sah_cost
    moved = (corners * np.float32([1, 2, 0.5])).copy()
    for threads, tree in zip((1, 2, 4), (first, *others), strict=True):
        refit(tree, moved, boxes, threads)
        np.testing.assert_array_equal(tree.memory, first.memory)
        assert tree.sah_cost == first.sah_cost
    check(first, moved, boxes)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.sparse(4)
def test_refitted_trees_hold_moved_triangles(name: str) -> None:
    corners = np.ascontiguousarray(CASES[name]())
    tree = build(corners)
    tree.memory[:64] = 7
    again = build(corners)
    cost = refit(tree, corners)
    assert cost == again.sah_cost
    np.testing.assert_array_equal(tree.memory[64:], again.memory[64:])
    assert (tree.memory[:64] == 7).all()
    tree.memory[:64] = 0
    moved = np.ascontiguousarray(corners[::-1] + np.float32([0.1, -0.2, 0.3]))
    refit(tree, moved)
    check(tree, moved, NOTHING)


def test_refit_moves_placed_primitives() -> None:
    corners, boxes = np.ascontiguousarray(SOUPS["scattered"]()), boxes_of(30)
    tree = build(corners, boxes)
    cost = refit(tree, corners, boxes_of(30, seed=1))
    assert cost == tree.sah_cost
    check(tree, corners, boxes_of(30, seed=1))


@pytest.mark.parametrize("name", ["nested", "exponential", "giants_among_dwarfs"])
@pytest.mark.sparse(4)
def test_skewed_input_makes_no_deep_trees(name: str) -> None:
    corners = np.ascontiguousarray(np.concatenate([CASES[name]()] * 3))
    tree = build(corners)
    assert tree.depth <= DEEPEST
    check(tree, corners, NOTHING)


@pytest.mark.parametrize("name", ["sphere", "scattered", "giants_among_dwarfs", "exponential", "far_away"])
def test_fewer_nodes_are_visited_than_with_one_triangle_per_leaf(name: str) -> None:
    corners = np.ascontiguousarray(CASES[name]())
    tree, other = build(corners), collapse(build_binary(*bounds(corners)), 8)
    area = half_area(np.concatenate([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]))
    nodes = 1 + half_area(other.box[other.child >= 0]).sum() / area
    assert tree.node_visits < nodes
    assert tree.sah_cost < 1.01 * sah_cost(other)


def test_leaves_of_smooth_meshes_are_well_filled() -> None:
    corners = sphere(20_000)
    tree = build(corners)
    assert len(corners) / tree.leaves > 5
