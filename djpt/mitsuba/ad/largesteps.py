"""Mitsuba's place of what smooths the steps of optimised meshes: `djpt.mitsuba.large_steps`."""

from __future__ import annotations

from djpt.mitsuba.large_steps import LargeSteps, SolveCholesky, mesh_laplacian

__all__ = ["LargeSteps", "SolveCholesky", "mesh_laplacian"]
