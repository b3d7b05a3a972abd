"""Meshes that deform: several sets of vertices of the same triangles, interpolated in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.numeric import as_array
from djpt.description.plugin import HIDDEN, Frame, ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.errors import ParameterError, SceneError
from djpt.jit.types import TensorXf
from djpt.shapes.mesh import Mesh
from djpt.shapes.meshes.data import MeshData, unit

__all__ = ["Deforming"]

Floats = NDArray[np.float32]


class Deforming(Mesh):
    """A mesh whose vertices move, each along straight lines from set to set, at constant speed between them.

    Parameters: two or more nested meshes in the order of time, which have the same triangles and say where the vertices
    are; `times` (one for each, ascending; default: evenly from 0 to 1); `to_world` (may be animated), `bsdf`,
    `flip_normals`, as of any mesh. Before the first time and after the last one the mesh stands still. Vertex normals,
    if the first mesh has some, are those of each set, interpolated; texture coordinates are those of the first mesh.

    It can't emit light, be instanced or bound a medium. There are no derivatives by its vertices.
    """

    deforms = True

    def __init__(self, props: Properties) -> None:
        nested = props.children("shape")
        meshes: list[Mesh] = [shape for _, shape in nested if shape.of_triangles and not shape.moves]
        if len(meshes) < 2 or len(meshes) != len(nested):
            found = ", ".join(f"'{key}' ({type(shape).__name__})" for key, shape in nested) or "none"
            raise SceneError(f"{props.node}: a 'deforming' needs two or more nested meshes that stay, found: {found}")
        first = meshes[0]
        for (key, _), mesh in zip(nested, meshes, strict=True):
            if len(mesh.positions) != len(first.positions) or not np.array_equal(mesh.indices, first.indices):
                raise SceneError(f"{props.node}: '{key}' must have the same triangles as '{nested[0][0]}'")
            if mesh.own_bsdf is not None or mesh.emitter() is not None:
                raise SceneError(f"{props.node}: '{key}' only says where vertices are: cover the 'deforming' itself")
        self.times = self._checked_times(props, len(meshes))
        self.sets: Floats = np.array([mesh.positions for mesh in meshes])
        self.normal_sets = normals_of(meshes)
        data = MeshData(self.sets[0], first.indices, None, first.texcoords)
        data.attributes = {name: values for name, (values, _) in first.attributes.items()}
        data.normals = None if self.normal_sets is None else self.normal_sets[0]
        self.adopt(data, props, compute_normals=False, checked=False)
        if self.flat:
            self.normal_sets = None
        if not self.to_world.is_identity:
            matrix = self.to_world.matrix
            self.sets = (self.sets @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
            if self.normal_sets is not None:
                turned = [unit(normals @ np.linalg.inv(matrix[:3, :3])) for normals in self.normal_sets]
                self.normal_sets = np.array(turned)
        for what, present in (
            ("emit light", self.emitter()),
            ("carry a sensor", self.sensor()),
            ("bound a medium", self.is_medium_transition()),
        ):
            if present:
                raise SceneError(f"{props.node}: a mesh that deforms can't {what}")

    @staticmethod
    def _checked_times(props: Properties, count: int) -> NDArray[np.float64]:
        """The entry `times`."""
        if "times" not in props:
            return np.linspace(0, 1, count)
        found = props.raw("times")
        with props.naming("times"):
            times = as_array([float(x) for x in found.replace(",", " ").split()] if isinstance(found, str) else found)
            if times.shape != (count,) or not (np.diff(times) > 0).all():
                raise SceneError(f"must be {count} ascending numbers, one for each mesh, found {times.tolist()}")
        return times

    # ---- parameters --------------------------------------------------------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put("faces", self.faces_parameter, HIDDEN | ParamFlags.ReadOnly, attribute="faces_parameter")
        callback.put("vertex_sets", self.vertex_sets)
        callback.put("vertex_texcoords", self.vertex_texcoords)
        for name in self.attributes:
            callback.put(name, getattr(self, name))

    @property
    def vertex_sets(self) -> TensorXf:
        """The parameter of this name: the vertices of each set, (sets, V, 3)."""
        return TensorXf(self.sets)

    @vertex_sets.setter
    def vertex_sets(self, value: Any) -> None:
        numbers = as_array(dr.detach(value)).astype(np.float32)
        if numbers.size != self.sets.size:
            raise ParameterError(f"{self.id()}.vertex_sets: must be {self.sets.size} numbers, found {numbers.size}")
        self.sets = numbers.reshape(self.sets.shape)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        super().parameters_changed([key for key in keys if key != "vertex_sets"])
        if "vertex_sets" in keys:
            if self.normal_sets is not None:
                meshes = [MeshData(positions, self.indices) for positions in self.sets]
                for data in meshes:
                    data.compute_normals()
                self.normal_sets = np.array([data.normals for data in meshes])
            self.positions = self.sets[0]
            self._measure()

    def can_be_followed(self) -> bool:
        return False

    # ---- on the host -------------------------------------------------------------------

    def move_into(self, frame: Frame) -> None:
        self.sets = frame.point(self.sets.reshape(-1, 3)).astype(np.float32).reshape(self.sets.shape)
        super().move_into(frame)

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        along = self.sets.astype(np.float64) @ direction
        return float(along.min()), float(along.max())

    def at_time(self, time: float) -> None:
        """Make a copy of the mesh one that stands still, as it is at a time."""
        k = int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2))
        u = float(np.clip((time - self.times[k]) / (self.times[k + 1] - self.times[k]), 0, 1))
        self.deforms = False
        if self.normal_sets is not None:
            self.normals = unit((1 - u) * self.normal_sets[k] + u * self.normal_sets[k + 1])
            self.__dict__.pop("vertex_normals", None)
        self.leave(((1 - u) * self.sets[k] + u * self.sets[k + 1]).astype(np.float32))


def normals_of(meshes: Sequence[Mesh]) -> Floats | None:
    """The vertex normals of all sets (sets, V, 3); None if the first has none."""
    if meshes[0].normals is None:
        return None
    rows = []
    for mesh in meshes:
        data = MeshData(mesh.positions, mesh.indices, mesh.normals)
        if data.normals is None:
            data.compute_normals()
        rows.append(data.normals)
    return np.array(rows)


register_shape("deforming", Deforming)
