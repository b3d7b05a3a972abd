"""Triangle meshes: the base of `obj`, `ply` and `serialized`, and meshes made from arrays."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.numeric import describe
from djpt.description.plugin import ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import ParameterError, SceneError
from djpt.geometry.axes import AxisPool
from djpt.geometry.triangle_sampling import square_to_triangle
from djpt.kernels import as_float, own_copy, own_floats
from djpt.records import PositionSample3f
from djpt.shapes.base import Shape
from djpt.shapes.meshes.cleaning import check_indices, clean
from djpt.shapes.meshes.data import MeshData, unit
from djpt.shapes.meshes.measures import Measures
from djpt.shapes.meshes.ply_writer import write_ply
from djpt.shapes.meshes.topology import is_closed
from djpt.shapes.questions import ShapeType
from djpt.types import Float, Point2f, UInt32

if TYPE_CHECKING:
    from djpt.geometry.mesh_set import MeshSet

__all__ = ["Mesh"]

HIDDEN = ParamFlags.NonDifferentiable
MOVES = ParamFlags.Differentiable | ParamFlags.Discontinuous


class Mesh(Shape):
    """Triangles that share vertices.

    Args:
        name: the mesh's name in messages and `traverse`, unless the scene gives one.
        vertex_positions: (V, 3) numbers.
        faces: (F, 3) indices of vertices, counter-clockwise seen from the side of the normal.
        vertex_normals: (V, 3), need not have unit length; without them triangles are shaded flat.
        vertex_texcoords: (V, 2); without them uv are the barycentric weights of corners 1 and 2.
        props: the remaining keys, a dict as in a scene description: `bsdf`, an `area` emitter,
            `to_world` (default identity), `flip_normals` (default false: the front is where corners
            run counter-clockwise), `face_normals` (default false; true drops the vertex normals).
        attributes: per vertex or face, names begin with ``vertex_`` or ``face_``; (V, C) or (F, C).

    Raises:
        SceneError: arrays of the wrong shape, an index out of range, no triangle left.

    Triangles without area or with a corner that isn't finite are dropped with a warning.
    """

    shape_kind = ShapeType.Mesh
    of_triangles = True
    values = dict.fromkeys(("first_face", "own_faces", "area"), HIDDEN)
    statics = ("flip_normals",)

    def __init__(
        self,
        name: str,
        vertex_positions: Any,
        faces: Any,
        vertex_normals: Any = None,
        vertex_texcoords: Any = None,
        props: Properties | Mapping[str, Any] | None = None,
        attributes: Mapping[str, Any] | None = None,
    ) -> None:
        own = props if isinstance(props, Properties) else properties(name, props)
        positions = rows(own.node, "vertex_positions", vertex_positions, 3)
        data = MeshData(positions, index_rows(own.node, faces))
        if vertex_normals is not None:
            data.normals = rows(own.node, "vertex_normals", vertex_normals, 3, len(positions))
        if vertex_texcoords is not None:
            data.texcoords = rows(own.node, "vertex_texcoords", vertex_texcoords, 2, len(positions))
        for key, value in (attributes or {}).items():
            count = {"vertex": len(positions), "face": len(data.indices)}.get(key.split("_")[0])
            if count is None:
                raise SceneError(f"{own.node}: the name of attribute '{key}' must begin with 'vertex_' or 'face_'")
            data.attributes[key] = rows(own.node, key, value, None, count)
        self.adopt(data, own, compute_normals=False)
        if own is not props:
            own.check_all_used()

    def adopt(self, data: MeshData, props: Properties, compute_normals: bool, source: str = "") -> None:
        """Take over a mesh's data, in object space; `source` names the file in messages."""
        Shape.__init__(self, props)
        face_normals = props.boolean("face_normals", False)
        where = f"{props.node}: {source}" if source else props.node
        if face_normals:
            data.normals = None
        data.transform(self.to_world)
        areas = clean(data, where)
        if compute_normals and not face_normals and data.normals is None:
            data.compute_normals()
        self.positions, self.indices = data.positions, data.indices
        self.normals, self.texcoords = data.normals, data.texcoords
        self.attributes: dict[str, tuple[NDArray[np.float32], Literal["vertex", "face"]]] = {
            key: (value, "vertex" if key.startswith("vertex_") else "face") for key, value in data.attributes.items()
        }
        self.set: MeshSet | None = None
        """The set of the scene's meshes that this one belongs to; set by `MeshSet`."""
        self.first_face = dr.opaque(UInt32, 0)
        for key in self.attributes:
            if hasattr(self, key) or key in ("vertex_positions", "vertex_normals", "vertex_texcoords"):
                raise SceneError(f"{where}: '{key}' can't be the name of an attribute: it means something else")
        self._expose()
        self._measure(areas)

    def join(self, meshes: MeshSet, first_face: int) -> None:
        """Join a set, in which the mesh's faces are numbered from `first_face` on."""
        self.set, self.first_face = meshes, dr.opaque(UInt32, first_face)

    # ---- parameters --------------------------------------------------------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put("faces", self.faces_parameter, attribute="faces_parameter")
        callback.put("vertex_positions", self.vertex_positions, MOVES)
        callback.put("vertex_normals", self.vertex_normals, MOVES)
        callback.put("vertex_texcoords", self.vertex_texcoords, ParamFlags.Differentiable)
        for name in self.attributes:
            callback.put(name, getattr(self, name), ParamFlags.Differentiable)

    def _expose(self) -> None:
        """Make the flat parameters that `traverse` reports from the host's arrays."""
        self.faces_parameter = own_copy(self.indices)
        self.vertex_positions = own_floats(self.positions)
        self.vertex_normals = Float() if self.normals is None else own_floats(self.normals)
        self.vertex_texcoords = Float() if self.texcoords is None else own_floats(self.texcoords)
        for name, (value, _) in self.attributes.items():
            setattr(self, name, own_floats(value))

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Take over edited parameters; as in Mitsuba, vertex normals are computed anew when vertices have moved.

        Raises:
            ParameterError: sizes that don't fit, an index out of range; nothing has changed then.
        """
        names = {"faces", "vertex_positions", "vertex_normals", "vertex_texcoords", *self.attributes}
        changed = names.intersection(keys)
        if not changed:
            return
        positions = self._read("vertex_positions", 3)
        indices = self.indices
        if "faces" in changed:
            indices = self._read("faces", 3, "faces_parameter").astype(np.uint32)
        if not len(indices):
            raise ParameterError(f"{self.id}.faces: a mesh needs at least one triangle")
        try:
            check_indices(indices, len(positions), f"{self.id}.faces")
        except SceneError as error:
            raise ParameterError(str(error)) from None
        resized = len(positions) != len(self.positions) or len(indices) != len(self.indices)
        normals = self._vertex_data("vertex_normals", 3, len(positions), changed)
        texcoords = self._vertex_data("vertex_texcoords", 2, len(positions), changed)
        attributes = {}
        for name, (old, kind) in self.attributes.items():
            count = len(positions if kind == "vertex" else indices)
            value = self._vertex_data(name, old.shape[1], count, changed)
            attributes[name] = (np.zeros((count, old.shape[1]), np.float32) if value is None else value, kind)

        # When an edit is undone the old normals must return, also those that the mesh was made with.
        moved = resized or not np.array_equal(positions, self.positions)
        self.positions, self.indices, self.texcoords, self.attributes = positions, indices, texcoords, attributes
        self.normals = None if normals is None else unit(normals)
        if self.normals is not None and moved:
            data = MeshData(positions, indices)
            data.compute_normals()
            self.normals = data.normals
        self._expose()
        self._measure()

    def _read(self, name: str, width: int, attribute: str | None = None) -> NDArray[Any]:
        """Read a parameter as rows on the host."""
        flat = np.array(dr.detach(getattr(self, attribute or name)))
        if flat.size % width:
            raise ParameterError(f"{self.id}.{name}: {flat.size} numbers don't make rows of {width}")
        return flat.reshape(-1, width)

    def _vertex_data(self, name: str, width: int, count: int, changed: set[str]) -> NDArray[np.float32] | None:
        """Read rows that belong to the vertices (or faces); zeros if only the number of these has changed."""
        value = self._read(name, width)
        if not len(value):
            return None
        if len(value) != count:
            if name in changed:
                raise ParameterError(f"{self.id}.{name}: must be {count} rows of {width}, found {len(value)}")
            if name != "vertex_normals":
                warnings.warn(f"{self.id}.{name}: the mesh has another size now; set to zero", stacklevel=2)
            value = np.zeros((count, width), np.float32)
        return value

    # ---- on the host -------------------------------------------------------------------

    def place(self, pool: AxisPool) -> None:
        """Do nothing: a mesh has no axes, and begins to be measured when it is made or edited."""

    def _measure(self, areas: NDArray[np.float64] | None = None) -> None:
        """Begin to measure the mesh anew; `areas` are those of its triangles if they are known."""
        self._measures = Measures(self.positions, self.indices, areas)
        self.__dict__.pop("area", None)
        self.own_faces = dr.opaque(UInt32, len(self.indices))

    @cached_property
    def area(self) -> Float:
        """The area of all triangles."""
        return as_float(self._measures.area)

    def write_ply(self, filename: str | os.PathLike[str]) -> None:
        """Write the mesh as it is now, in world space, to a binary PLY file with all its attributes.

        Raises:
            FileError: the file can't be written.
        """
        attributes = {name: values for name, (values, _) in self.attributes.items()}
        write_ply(filename, MeshData(self.positions, self.indices, self.normals, self.texcoords, attributes))

    def primitive_count(self) -> int:
        return len(self.indices)

    def _box(self, index: int | None) -> tuple[Any, Any]:
        if index is None:
            return super()._box(index)
        super()._box(index)
        corners = self.positions[self.indices[index]]
        return corners.min(axis=0), corners.max(axis=0)

    def is_closed(self) -> bool:
        return is_closed(self.positions, self.indices)

    def face_areas(self) -> NDArray[np.float64]:
        """The areas of all triangles, (F,)."""
        return self._measures.face_areas

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        return self._measures.interval(direction)

    # ---- in kernels --------------------------------------------------------------------

    def surface_area(self) -> Float:
        return self.area

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        # As in Mitsuba, y chooses the triangle by area and is stretched for use within the triangle.
        if self.set is None:
            point: PositionSample3f = self.alone().shapes()[0].draw_point(sample)
            return point
        index, y = self.set.areas.sample(self.first_face, self.own_faces, self.area, sample.y)
        b1, b2 = square_to_triangle(Point2f(sample.x, y))
        p, n, uv = self.set.point(self.first_face + index, b1, b2)
        return PositionSample3f.of(p, n, uv, dr.rcp(self.area))


def properties(name: str, props: Mapping[str, Any] | None) -> Properties:
    """The properties of a mesh that is made in Python; nested dicts become plugins."""
    from djpt.description.loader import load_dict

    if props is not None and not isinstance(props, Mapping):
        raise SceneError(f"{name}: props must be a dict, found {describe(props)}")
    values = dict(props or {})
    for key, value in values.items():
        if isinstance(value, Mapping):
            values[key] = plugin = load_dict(value)
            plugin.id = f"{name}.{key}"
    return Properties("mesh", name, values)


def rows(node: str, name: str, value: Any, width: int | None, count: int | None = None) -> NDArray[np.float32]:
    """Convert numbers to rows, (N, `width`) float32; flat arrays (also of Dr.Jit) are cut into rows."""
    found = numbers(node, name, value)
    if found.ndim == 1 and (width or count):
        width = width or found.size // max(count or 1, 1)
        found = found.reshape(-1, width) if width and found.size % width == 0 else found
    if found.ndim != 2 or (width and found.shape[1] != width) or (count is not None and len(found) != count):
        wanted = f"({'N' if count is None else count}, {width or 'channels'})"
        raise SceneError(f"{node}: '{name}' must have the shape {wanted}, found {found.shape}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(found, np.float32)


def index_rows(node: str, value: Any) -> NDArray[np.uint32]:
    """Convert vertex indices to (F, 3) uint32."""
    found = numbers(node, "faces", value)
    found = found.reshape(-1, 3) if found.ndim == 1 and found.size % 3 == 0 else found
    if found.ndim != 2 or found.shape[1] != 3:
        raise SceneError(f"{node}: 'faces' must have the shape (F, 3), found {found.shape}")
    if found.size and not ((found >= 0) & (found < 2**32) & (found == np.floor(found))).all():
        raise SceneError(f"{node}: 'faces' must be whole numbers from 0 on, found {describe(value)}")
    return np.ascontiguousarray(found, np.uint32)


def numbers(node: str, name: str, value: Any) -> NDArray[Any]:
    """Convert to an array of numbers; NaN is allowed, since cleaning deals with it."""
    try:
        found = np.array(dr.detach(value) if dr.is_array_v(value) else value)
    except Exception:
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise SceneError(f"{node}: '{name}' must be an array of numbers, found {describe(value)}")
    return found
