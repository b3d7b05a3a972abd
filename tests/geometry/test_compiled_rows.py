"""Corners and records of triangles that machine code writes: the same as NumPy's, with any number of threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from djpt.geometry.bvh.build import rows
from djpt.geometry.bvh.build.builder import Workers, workers
from djpt.geometry.bvh.build.rows import corners_of, write_rows
from djpt.geometry.bvh.leaves import face_frames
from djpt.shapes.mesh import Mesh
from tests.kit.triangle_soups import sphere

ALONE = Workers(None)


@dataclass
class Faces:
    """What frames depend on. Unlike a mesh, it may have triangles without area."""

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    texcoords: NDArray[np.float32] | None = None
    flip_normals: bool = False


def random_faces(count: int, seed: int, textured: bool = False, flipped: bool = False, scale: float = 1) -> Faces:
    rng = np.random.default_rng(seed)
    vertices = count // 2 + 3
    positions = rng.normal(size=(vertices, 3)).astype(np.float32) * np.float32(scale)
    indices = rng.integers(0, vertices, (count, 3)).astype(np.uint32)
    # Whole numbers: some determinants are zero.
    texcoords = rng.integers(-3, 4, (vertices, 2)).astype(np.float32) if textured else None
    return Faces(positions, indices, texcoords, flipped)


def awkward_faces(textured: bool, flipped: bool) -> Faces:
    """Points, lines, slivers, triangles across the axes, and numbers that aren't finite."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    thin = [[0, 0, 0], [2, 0, 0], [1, 1e-20, 0], [1, 1e-7, 3e-8]]
    broken = [[np.nan, 0, 0], [np.inf, 1, 0], [3e38, 3e38, -3e38], [-3e38, 1, 3e38]]
    positions = np.concatenate([axes, thin, axes * 1e-15, axes * 1e-30, axes * 1e15, broken]).astype(np.float32)
    indices = np.random.default_rng(7).integers(0, len(positions), (3000, 3)).astype(np.uint32)
    indices[:10, 1:] = indices[:10, :1]
    texcoords = np.random.default_rng(8).choice([0, 0.5, 1, -1e-30, 1e30, np.nan, np.inf], (len(positions), 2))
    return Faces(positions, indices, texcoords.astype(np.float32) if textured else None, flipped)


CASES = {
    "plain": lambda: [random_faces(1000, 0)],
    "flipped": lambda: [random_faces(1001, 1, flipped=True)],
    "textured": lambda: [random_faces(1003, 2, textured=True)],
    "textured_flipped": lambda: [random_faces(1007, 3, True, True)],
    "tiny": lambda: [random_faces(100, 4, scale=1e-12)],
    "huge": lambda: [random_faces(100, 5, scale=1e12)],
    "one": lambda: [random_faces(1, 6)],
    "seven": lambda: [random_faces(7, 7, True)],
    "eight": lambda: [random_faces(8, 8)],
    "awkward": lambda: [awkward_faces(False, flipped) for flipped in (False, True)],
    "awkward_textured": lambda: [awkward_faces(True, flipped) for flipped in (False, True)],
    "several": lambda: [random_faces(1 + 37 * k % 50, k, k % 3 == 0, k % 2 == 0) for k in range(60)],
    "with_empty": lambda: [random_faces(count, count, count % 2 == 0) for count in (0, 5, 0, 20, 0)],
    "nothing": lambda: [],
}


def written(
    meshes: list[Any], order: NDArray[np.uint32], corners: NDArray[np.float32], team: Workers = ALONE
) -> NDArray[np.uint32]:
    """All records, with the labels 100, 101 ...; faces count from 5000 on."""
    target = np.full((len(order), 8), 0xDEADBEEF, np.uint32)
    write_rows(target, order, meshes, [100 + k for k in range(len(meshes))], corners, 5000, team)
    return target


def permutation(count: int, seed: int = 0) -> NDArray[np.uint32]:
    return np.random.default_rng(seed).permutation(count).astype(np.uint32)


@pytest.mark.parametrize("case", CASES)
def test_rows(case: str) -> None:
    meshes = CASES[case]()
    corners = corners_of(meshes, ALONE)
    expected = [mesh.positions[mesh.indices] for mesh in meshes]
    np.testing.assert_array_equal(corners, np.concatenate([np.zeros((0, 3, 3), np.float32), *expected]))
    with np.errstate(all="ignore"):
        normals, directions = face_frames(meshes, corners)
    for order in (np.arange(len(corners), dtype=np.uint32), permutation(len(corners))):
        target = written(meshes, order, corners)
        floats = target.view(np.float32)
        assert (target[:, 0] == 0).all()
        np.testing.assert_array_equal(floats[:, 1:4], normals[order])
        # Where NumPy fuses products and sums, the last bits differ.
        np.testing.assert_allclose(floats[:, 6:], directions[order], rtol=0, atol=1e-6)
        counts = [len(mesh.indices) for mesh in meshes]
        np.testing.assert_array_equal(target[:, 4], np.repeat(np.arange(len(meshes)) + 100, counts)[order])
        np.testing.assert_array_equal(target[:, 5], order + 5000)


def test_one_triangle() -> None:
    mesh = Faces(np.array([[0, 0, 2], [1, 0, 2], [0, 1, 2]], np.float32), np.array([[0, 1, 2]], np.uint32))
    row = written([mesh], permutation(1), corners_of([mesh], ALONE)).view(np.float32)[0]
    np.testing.assert_array_equal(row[1:4], [0, 0, 1])
    np.testing.assert_array_equal(row[6:], [1, 0])


def test_triangles_without_area() -> None:
    point = Faces(np.ones((1, 3), np.float32), np.zeros((9, 3), np.uint32))
    rows = written([point], permutation(9), corners_of([point], ALONE)).view(np.float32)
    np.testing.assert_array_equal(rows[:, 1:4], np.tile([0, 0, 1], (9, 1)))
    np.testing.assert_array_equal(rows[:, 6:], np.tile([1, 0], (9, 1)))


def test_meshes_of_a_scene() -> None:
    soup = sphere(30)
    faces = np.arange(3 * len(soup)).reshape(-1, 3)
    positions = soup.reshape(-1, 3)
    meshes = [
        Mesh("plain", positions, faces),
        Mesh("textured", positions + 3, faces, vertex_texcoords=positions[:, :2], props={"flip_normals": True}),
    ]
    corners = corners_of(meshes, ALONE)
    np.testing.assert_array_equal(corners, np.concatenate([mesh.positions[mesh.indices] for mesh in meshes]))
    normals, directions = face_frames(meshes, corners)
    order = permutation(len(corners))
    rows = written(meshes, order, corners).view(np.float32)
    np.testing.assert_array_equal(rows[:, 1:4], normals[order])
    np.testing.assert_allclose(rows[:, 6:], directions[order], rtol=0, atol=1e-6)


def test_other_layouts_in_memory() -> None:
    mesh = random_faces(100, 9, True)
    corners, order = corners_of([mesh], ALONE), permutation(100)
    assert mesh.texcoords is not None
    other = Faces(*(np.asfortranarray(a) for a in (mesh.positions, mesh.indices, mesh.texcoords)))
    np.testing.assert_array_equal(corners_of([other], ALONE), corners)
    expected = written([mesh], order, corners)
    np.testing.assert_array_equal(written([other], order, np.asfortranarray(corners)), expected)


def test_same_for_every_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    meshes = [
        random_faces(30_000, 0),
        *(random_faces(60, k, k % 2 == 0) for k in range(50)),
        random_faces(9000, 1, True),
    ]
    order = permutation(42_000)
    corners = corners_of(meshes, ALONE)
    expected = written(meshes, order, corners)
    monkeypatch.setattr(rows, "FACES", 1000)
    for threads in (1, 2, 4):
        with workers(len(order), threads) as team:
            np.testing.assert_array_equal(corners_of(meshes, team), corners)
            np.testing.assert_array_equal(written(meshes, order, corners, team), expected)


def test_tasks_cover_all_parts() -> None:
    parts = rows.Parts([random_faces(count, 0) for count in (1, 0, 2 * rows.FACES, 5, rows.FACES - 6, 3)])
    assert [first for first, _ in parts.tasks] == [0, *(end for _, end in parts.tasks)][:-1]
    assert parts.tasks[-1][1] == len(parts.table)
    assert (parts.table[1:, 0] == parts.table[:-1, 1]).all()
    sizes = [int(parts.table[end - 1, 1] - parts.table[first, 0]) for first, end in parts.tasks]
    assert sum(sizes) == parts.face_count and max(sizes) <= 2 * rows.FACES
