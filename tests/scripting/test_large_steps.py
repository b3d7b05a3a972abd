"""Differential coordinates of meshes: the system, both ways, their derivatives, and what is refused."""

from __future__ import annotations

import sys
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ArgumentError, DjptError
from djpt.jit.types import TensorXf

pytest.importorskip("scipy")

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]], np.float32)
FACES = np.array([[0, 1, 2], [3, 4, 5]], np.uint32)
"""A square of two triangles that have vertices of their own along the diagonal."""
DISTINCT = np.array([0, 2, 1, 2, 3, 1])
"""The distinct vertex of each, in the order of their coordinates."""


def system(weight: float) -> np.ndarray:
    """I + weight L of the square, whose diagonal joins the distinct vertices 1 and 2."""
    adjacency = np.array([[0, 1, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 1, 0]])
    return np.eye(4) + weight * (np.diag(adjacency.sum(0)) - adjacency)


def smooth(weight: float = 25.0) -> Any:
    return djpt.ad.LargeSteps(TensorXf(VERTICES), djpt.TensorXu(FACES), weight)


def test_coordinates_solve_the_system() -> None:
    steps = smooth()
    assert steps.n_verts == 4
    points = np.zeros((4, 3))
    points[DISTINCT] = VERTICES
    u = steps.to_differential(TensorXf(VERTICES))
    np.testing.assert_allclose(np.array(u), system(25.0) @ points, atol=1e-4)
    np.testing.assert_allclose(np.array(steps.from_differential(u)), VERTICES, atol=1e-6)


def test_the_laplacian_is_mitsubas(mi: Any) -> None:
    his = pytest.importorskip("mitsuba.ad.largesteps").mesh_laplacian
    dense = []
    for laplacian in (djpt.ad.largesteps.mesh_laplacian, his):
        (rows, columns), values = laplacian(4, DISTINCT[FACES], 3.0)
        matrix = np.zeros((4, 4))
        np.add.at(matrix, (rows, columns), values)
        dense.append(matrix)
    np.testing.assert_allclose(dense[0], dense[1])
    np.testing.assert_allclose(dense[0], system(3.0))


def test_derivatives_are_smoothed() -> None:
    steps, inverse = smooth(), np.linalg.inv(system(25.0))
    u = TensorXf(np.zeros((4, 3), np.float32))
    dr.enable_grad(u)
    v = steps.from_differential(u)
    weights = np.arange(18, dtype=np.float32).reshape(6, 3)
    dr.backward(dr.sum((v * TensorXf(weights)).array))
    gathered = np.zeros((4, 3))
    np.add.at(gathered, DISTINCT, weights)
    np.testing.assert_allclose(np.array(dr.grad(u)), inverse @ gathered, rtol=1e-5)

    change = np.arange(12, dtype=np.float32).reshape(4, 3)
    u = TensorXf(np.zeros((4, 3), np.float32))
    dr.enable_grad(u)
    dr.set_grad(u, TensorXf(change))
    changed = dr.forward_to(steps.from_differential(u))
    np.testing.assert_allclose(np.array(changed), (inverse @ change)[DISTINCT], rtol=1e-5)

    v = TensorXf(VERTICES)
    dr.enable_grad(v)
    dr.set_grad(v, dr.ones(TensorXf, (6, 3)))
    np.testing.assert_allclose(np.array(dr.forward_to(steps.to_differential(v))), 1, atol=1e-5)  # L 1 = 0


def test_parameters_of_meshes_go_in_and_out() -> None:
    mesh = djpt.Mesh("square", VERTICES, FACES)
    params = djpt.traverse(mesh)
    steps = djpt.ad.LargeSteps(params["vertex_positions"], params["faces"])
    params["vertex_positions"] = steps.from_differential(steps.to_differential(params["vertex_positions"]) * 2)
    params.update()
    np.testing.assert_allclose(np.array(params["vertex_positions"]), 2 * VERTICES.ravel(), atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([1.0, 2.0], FACES), r"'verts' must have the shape \(N, 3\), found \(2,\)"),
        ((VERTICES, [[0, 1, 6]]), "faces must name vertices from 0 to 5"),
        ((VERTICES, FACES, -1.0), r"'lambda_' must not be negative, found -1\.0"),
    ],
)
def test_what_is_refused(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        djpt.ad.LargeSteps(*arguments)


def test_coordinates_of_another_mesh_are_refused() -> None:
    with pytest.raises(ArgumentError, match="expected 4 points, found 3 numbers"):
        smooth().from_differential(TensorXf(np.zeros((1, 3), np.float32)))


def test_without_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    with pytest.raises(DjptError, match=r"pip install scipy"):
        smooth()
