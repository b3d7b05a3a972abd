"""Smooth steps for the vertices of a mesh, by optimising other variables in their place.

B. Nicolet, A. Jacobson and W. Jakob, "Large Steps in Inverse Rendering of Geometry", ACM Transactions on Graphics
40(6), 2021: in place of the vertices v optimise

    u = (I + lambda L) v,

where L is the combinatorial Laplacian of the mesh: the degrees of the vertices minus the adjacency matrix. The gradient
with respect to u is that with respect to v, smoothed by (I + lambda L)^-1.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.errors import ArgumentError, DjptError
from djpt.jit.types import Float, TensorXf, UInt32

__all__ = ["LargeSteps", "SolveCholesky", "mesh_laplacian"]


class LargeSteps:
    """The differential coordinates of a mesh: u = (I + lambda L) v, and back. Both ways are differentiable.

    Vertices at equal places, such as those along seams of the texture coordinates, are one vertex here.

    Args:
        verts: The vertices: (V, 3), or the 3 V numbers of a parameter `vertex_positions`.
        faces: The vertices of each face, (F, 3) or flat.
        lambda_: How far gradients are spread on the surface, more for finer meshes; not negative.

    Raises:
        ArgumentError: The arrays have other shapes, or faces name vertices that aren't there.
        DjptError: SciPy isn't installed.
    """

    def __init__(self, verts: Any, faces: Any, lambda_: float = 19.0) -> None:
        points = triples("verts", verts).astype(np.float32)
        corners = triples("faces", faces).astype(np.int64)
        if corners.size and not 0 <= corners.min() <= corners.max() < len(points):
            raise ArgumentError(f"LargeSteps: faces must name vertices from 0 to {len(points) - 1}")
        _, first, merged = np.unique(points, axis=0, return_index=True, return_inverse=True)
        merged = merged.ravel()
        if not lambda_ >= 0:
            raise ArgumentError(f"LargeSteps: 'lambda_' must not be negative, found {lambda_}")
        self.n_verts = len(first)
        """The number of distinct vertices."""
        self.index, self.inverse = UInt32(first), UInt32(merged)
        (rows, columns), values = mesh_laplacian(self.n_verts, merged[corners], lambda_)
        matrix = sparse().coo_matrix((values, (rows, columns)), (self.n_verts, self.n_verts)).tocsc()
        self.solver = Cholesky(matrix)
        entries = matrix.tocoo()
        self.rows, self.cols = UInt32(entries.row), UInt32(entries.col)
        self.data = Float(entries.data)

    def to_differential(self, v: Any) -> TensorXf:
        """The differential coordinates (N, 3) of vertices (V, 3), also given as an array of points or flat."""
        flat = numbers(v, len(self.inverse))
        source = dr.gather(UInt32, self.index, self.cols)
        u = dr.zeros(Float, 3 * self.n_verts)
        for axis in range(3):
            products = self.data * dr.gather(Float, flat, 3 * source + axis)
            dr.scatter_add(u, products, 3 * self.rows + axis)
        return TensorXf(u, shape=(self.n_verts, 3))

    def from_differential(self, u: Any) -> TensorXf:
        """The vertices (V, 3) of differential coordinates (N, 3), also given as an array of points or flat."""
        given = TensorXf(numbers(u, self.n_verts), shape=(self.n_verts, 3))
        v = dr.custom(SolveCholesky, self.solver, given)
        return dr.take(v, self.inverse, axis=0)


class SolveCholesky(dr.CustomOp):
    """x = A^-1 b for a symmetric matrix A, as an operation of Dr.Jit: its derivatives are A^-1 times those of b."""

    def eval(self, solver: Any, u: TensorXf) -> TensorXf:
        self.solver = solver
        return self._solved(u)

    def forward(self) -> None:
        self.set_grad_out(self._solved(self.grad_in("u")))

    def backward(self) -> None:
        self.set_grad_in("u", self._solved(self.grad_out()))

    def name(self) -> str:
        return "Cholesky solve"

    def _solved(self, b: Any) -> TensorXf:
        found = np.ascontiguousarray(self.solver.solve(np.array(b, dtype=np.float64)), dtype=np.float32)
        return TensorXf(Float(found.ravel()), shape=found.shape)


class Cholesky:
    """The factors of a sparse, symmetric, positive definite matrix, by SuperLU (X. Li, 2005) as SciPy has it.

    Computed in double precision: with large lambda the matrix is badly conditioned.
    """

    def __init__(self, matrix: Any) -> None:
        # A definite matrix needs no pivots: then the order of elimination is that of a Cholesky factorization.
        self._factors = sparse().linalg.splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, b: NDArray[np.float64]) -> NDArray[np.float64]:
        """The solutions (N, K) of A x = b for each column of b (N, K)."""
        return self._factors.solve(b)


def mesh_laplacian(n_verts: int, faces: Any, lambda_: float) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """The entries of I + lambda L for a mesh of `n_verts` vertices: (2, K) rows and columns, and (K,) values.

    Entries at the same place add up.
    """
    corners = np.asarray(faces).reshape(-1, 3)
    ends = np.stack([corners[:, [1, 2, 0]].ravel(), corners[:, [2, 0, 1]].ravel()])
    edges = np.unique(np.concatenate([ends, ends[::-1]], axis=1), axis=1)
    weight = np.full(edges.shape[1], float(lambda_))
    diagonal = np.tile(np.arange(n_verts), (2, 1))
    degrees = np.stack([edges[0], edges[0]])
    indices = np.concatenate([edges, degrees, diagonal], axis=1)
    return indices, np.concatenate([-weight, weight, np.ones(n_verts)])


def triples(name: str, array: Any) -> NDArray[Any]:
    """The rows (N, 3) of an array that is given so, flat, or as Dr.Jit's points."""
    found = np.array(array)
    if dr.is_array_v(array) and not dr.is_tensor_v(array) and dr.size_v(type(array)) == 3:
        found = found.T
    if found.ndim == 1 and found.size % 3 == 0:
        found = found.reshape(-1, 3)
    if found.ndim != 2 or found.shape[1] != 3:
        raise ArgumentError(f"LargeSteps: '{name}' must have the shape (N, 3), found {found.shape}")
    return found


def numbers(array: Any, count: int) -> Float:
    """The flat numbers of `count` points."""
    flat = Float(dr.ravel(array)) if dr.is_array_v(array) else Float(np.asarray(array, np.float32).ravel())
    if dr.width(flat) != 3 * count:
        raise ArgumentError(f"LargeSteps: expected {count} points, found {dr.width(flat)} numbers")
    return flat


def sparse() -> Any:
    """The package `scipy.sparse`."""
    try:
        import scipy.sparse
        import scipy.sparse.linalg
    except ImportError:
        raise DjptError("LargeSteps solves by SciPy, which isn't installed: pip install scipy") from None
    return scipy.sparse
