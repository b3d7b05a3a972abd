"""Triangle meshes: the base of `obj`, `ply` and `serialized`, and meshes made from arrays."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, overload

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.core.files import read_bytes
from djpt.core.records import RAY_EPSILON, PositionSample3f, Ray3f, RayFlags, SurfaceInteraction3f
from djpt.core.warp import square_to_uniform_triangle
from djpt.description.files import read_once, resolve
from djpt.description.parameters import NEWER_NAMES
from djpt.description.plugin import HIDDEN, ParamFlags, TraversalCallback
from djpt.description.properties import Properties
from djpt.errors import FileError, ParameterError, SceneError
from djpt.jit.kernels import as_float, own_copy, own_floats
from djpt.jit.types import Bool, Float, Point2f, Point3f, UInt32
from djpt.shapes.base import Shape
from djpt.shapes.meshes.data import MeshData, clean, unit
from djpt.shapes.meshes.making import Edits, check_prefix, of_arrays, of_zeros, rows
from djpt.shapes.meshes.queries import Measures, MeshQueries, is_closed, is_remote
from djpt.shapes.mitsuba_api import ShapeType

if TYPE_CHECKING:
    from djpt.description.plugin import Frame
    from djpt.shapes.meshes.mesh_set import MeshSet
    from djpt.shapes.silhouettes.base import Silhouette

__all__ = ["Mesh", "MeshFile"]

PARAMETERS = ("faces_parameter", "vertex_positions", "vertex_normals", "vertex_texcoords")
"""The attributes that hold the parameters of all meshes; made when they are asked for, which most never are."""
STORED = {"faces": "faces_parameter"}
"""The attributes of parameters whose names mean something else."""


class Mesh(MeshQueries, Shape):
    """Triangles that share vertices: ``Mesh(name, vertex_positions, faces, ...)``.

    ``Mesh(name, vertex_count, face_count, props, has_vertex_normals, has_vertex_texcoords)``, Mitsuba's form, is a
    mesh of zeros, which can be seen after its parameters have been assigned through `traverse`.

    Args:
        name: the mesh's name in messages and `traverse`, unless the scene gives one.
        vertex_positions: (V, 3) numbers. Mitsuba 3.10's names of arrays, `positions`, `normals` and `texcoords`, are
            understood as keywords, too.
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
    points_parameter = "vertex_positions"
    values = dict.fromkeys(("first_face", "own_faces", "area"), HIDDEN)
    statics = ("flip_normals", "set")

    @overload
    def __init__(
        self,
        name: str,
        vertex_positions: Any,
        faces: Any,
        vertex_normals: Any = None,
        vertex_texcoords: Any = None,
        props: Properties | Mapping[str, Any] | None = None,
        attributes: Mapping[str, Any] | None = None,
    ) -> None: ...
    @overload
    def __init__(
        self,
        name: str,
        vertex_count: int,
        face_count: int,
        props: Properties | Mapping[str, Any] | None = None,
        has_vertex_normals: bool = False,
        has_vertex_texcoords: bool = False,
    ) -> None: ...
    @overload
    def __init__(self, props: Properties) -> None: ...

    def __init__(self, *arguments: Any, **named: Any) -> None:
        if len(arguments) + len(named) == 1:
            arguments, named = ("", 0, 0, *arguments), {**named}
        named = {NEWER_NAMES.get(key, (key,))[0]: value for key, value in named.items()}
        counted = "vertex_count" in named or (len(arguments) > 1 and isinstance(arguments[1], (int, np.integer)))
        data, own, given = (of_zeros if counted else of_arrays)(*arguments, **named)
        self.adopt(data, own, compute_normals=False, checked=not counted)
        if own is not given:
            own.check_all_used()

    def adopt(
        self, data: MeshData, props: Properties, compute_normals: bool, source: str = "", checked: bool = True
    ) -> None:
        """Take over a mesh's data, in object space.

        Args:
            data: the mesh.
            props: the remaining keys.
            compute_normals: whether vertices without normals get some.
            source: the file, for messages.
            checked: false for a mesh that will be filled later.
        """
        Shape.__init__(self, props)
        self.flat = face_normals = props.boolean("face_normals", False)
        where = f"{props.node}: {source}" if source else props.node
        if face_normals:
            data.normals = None
        own = data.positions
        data.transform(self.to_world)
        areas = clean(data, where) if checked else None
        if compute_normals and not face_normals and data.normals is None:
            data.compute_normals()
        self.positions, self.indices = data.positions, data.indices
        # From far away their digits are lost: float32 keeps seven, of which the distance takes some.
        placed = own is not data.positions and is_remote(self.positions)
        self._own_positions = (own, self.positions) if placed else None
        self.normals, self.texcoords = data.normals, data.texcoords
        self.set: MeshSet | None = None
        """The set of the scene's meshes that this one belongs to; set by `MeshSet`."""
        self._first_face = 0
        for key in data.attributes:
            self._check_attribute(key, where)
        self.attributes: dict[str, tuple[NDArray[np.float32], Literal["vertex", "face"]]] = {
            key: (value, "vertex" if key.startswith("vertex_") else "face") for key, value in data.attributes.items()
        }
        self._measure(areas)

    def _check_attribute(self, name: str, where: str) -> None:
        """Raise `SceneError` unless an attribute can have this name."""
        check_prefix(where, name)
        if hasattr(self, name):
            raise SceneError(f"{where}: '{name}' can't be the name of an attribute: it has another meaning")

    def exact_positions(self) -> NDArray[np.float64]:
        """The vertices (V, 3) in world space; of a mesh placed far away in double precision, unless it was edited."""
        if self._own_positions is None or self._own_positions[1] is not self.positions:
            return self.positions.astype(np.float64)
        matrix = self.to_world.matrix
        placed: NDArray[np.float64] = self._own_positions[0] @ matrix[:3, :3].T + matrix[:3, 3]
        return placed

    def leave(self, positions: NDArray[np.float32] | None = None) -> None:
        """Make a copy of a mesh independent of the original's set, and move its vertices if `positions` are given."""
        super().leave()
        self.set, self._first_face, self._own_positions = None, 0, None
        self.positions = self.positions if positions is None else positions
        for derived in ("first_face", "vertex_positions"):
            self.__dict__.pop(derived, None)
        self._measure()

    def attach_to(self, placed: Any, own: NDArray[np.float32]) -> None:
        """Attach the vertices of a mesh that has been moved to a transform with gradients, from their `own` places."""
        index = dr.arange(UInt32, len(own))
        vertices = Point3f(*(dr.gather(Float, own_floats(own), 3 * index + k) for k in range(3)))
        moved = placed.transform_point(vertices)
        attached = dr.ravel(moved)
        place = own_floats(self.positions)
        positions: Any = dr.replace_grad(place, attached)  # type: ignore[func-returns-value]
        self.vertex_positions = positions

    def move_into(self, frame: Frame) -> None:
        self.leave(frame.point(self.exact_positions()).astype(np.float32))
        self.move_nested(frame)

    def join(self, meshes: MeshSet, first_face: int) -> None:
        """Join a set, in which the mesh's faces are numbered from `first_face` on."""
        self.set, self._first_face = meshes, first_face
        self.__dict__.pop("first_face", None)

    # ---- parameters --------------------------------------------------------------------

    def traverse_geometry(self, callback: TraversalCallback) -> None:
        callback.put("faces", self.faces_parameter, attribute="faces_parameter")
        callback.put("vertex_positions", self.vertex_positions, self.motion_flags())
        # Normals follow from the positions; texture coordinates and attributes are read on the host.
        callback.put("vertex_normals", self.vertex_normals, HIDDEN | ParamFlags.Discontinuous)
        callback.put("vertex_texcoords", self.vertex_texcoords)
        for name in self.attributes:
            callback.put(name, getattr(self, name))

    @cached_property
    def faces_parameter(self) -> UInt32:
        """The parameter `faces`: the corners of all triangles, one after the other."""
        return own_copy(self.indices)

    @cached_property
    def vertex_positions(self) -> Float:
        """The parameter of this name: the coordinates of all vertices, one after the other."""
        return own_floats(self.positions)

    @cached_property
    def vertex_normals(self) -> Float:
        """The parameter of this name, likewise; empty if there are none."""
        return Float() if self.normals is None else own_floats(self.normals)

    @cached_property
    def vertex_texcoords(self) -> Float:
        """The parameter of this name, likewise; empty if there are none."""
        return Float() if self.texcoords is None else own_floats(self.texcoords)

    def __getattr__(self, name: str) -> Float:
        """The parameter that holds an attribute of vertices or faces; made when it is asked for, like the others."""
        attributes = self.__dict__.get("attributes", {})
        if name not in attributes:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        value = own_floats(attributes[name][0])
        setattr(self, name, value)
        return value

    def make_parameters(self) -> None:
        for name in (*PARAMETERS, *self.attributes):
            getattr(self, name)

    def prepare_to_record(self) -> None:
        super().prepare_to_record()
        if self.original is None and (alone := self.alone().shapes()[0].set) is not None:
            _ = alone.areas  # frozen functions can't make the table that points are sampled by

    def _forget(self) -> None:
        """Let the parameters be made from the host's arrays again, and what follows from the faces."""
        self.build_directed_edges()
        for name in (*PARAMETERS, *self.attributes):
            if not (name == "vertex_positions" and self.parameters_grad_enabled()):
                self.__dict__.pop(name, None)

    def parameters_changed(self, keys: Sequence[str]) -> None:
        """Take over edited parameters; as in Mitsuba, moved vertices get new normals unless normals are edited, too.

        Raises:
            ParameterError: sizes that don't fit, an index out of range; nothing has changed then.
        """
        names = {"faces", "vertex_positions", "vertex_normals", "vertex_texcoords", *self.attributes}
        changed = names.intersection(keys)
        if not changed:
            return
        edits = Edits(self.id(), lambda name: getattr(self, STORED.get(name, name)), changed)
        positions = edits.rows("vertex_positions", 3)
        indices = edits.faces(self.indices, len(positions))
        resized = len(positions) != len(self.positions) or len(indices) != len(self.indices)
        normals = edits.fitting_rows("vertex_normals", 3, len(positions))
        texcoords = edits.fitting_rows("vertex_texcoords", 2, len(positions))
        attributes = {}
        for name, (old, kind) in self.attributes.items():
            count = len(positions if kind == "vertex" else indices)
            value = edits.fitting_rows(name, old.shape[1], count)
            attributes[name] = (np.zeros((count, old.shape[1]), np.float32) if value is None else value, kind)

        # When an edit is undone the old normals must return, also those that the mesh was made with. Derivatives by the
        # positions are those of an image whose normals follow from them.
        moved = resized or not np.array_equal(positions, self.positions) or self.parameters_grad_enabled()
        self.positions, self.indices, self.texcoords, self.attributes = positions, indices, texcoords, attributes
        self.normals = None if normals is None else unit(normals)
        if self.normals is not None and moved and "vertex_normals" not in changed:
            data = MeshData(positions, indices)
            data.compute_normals()
            self.normals = data.normals
        self._forget()
        self._measure()

    def attached_parameter(self, name: str, value: Any) -> Any:
        if name != "vertex_positions" or not self.can_be_followed():
            raise ParameterError(f"{self.id()}.{name}: gradients with respect to this parameter aren't available")
        return value

    def add_attribute(self, name: str, size: int, buffer: Any) -> None:
        """Add numbers to the vertices or the triangles, for `mesh_attribute` textures.

        Args:
            name: begins with ``vertex_`` or ``face_``.
            size: how many numbers each has.
            buffer: all of them, flat or as rows.

        Raises:
            SceneError: the name is in use, or the count of numbers is wrong.
            ParameterError: the mesh belongs to a scene already.
        """
        self._require_alone("add_attribute")
        self._check_attribute(name, self.id())
        kind: Literal["vertex", "face"] = "vertex" if name.startswith("vertex_") else "face"
        count = len(self.positions if kind == "vertex" else self.indices)
        self.attributes[name] = (rows(self.id(), name, buffer, size, count), kind)

    def remove_attribute(self, name: str) -> None:
        """Remove an attribute; raises `ParameterError` if there is none, or the mesh belongs to a scene already.

        Textures can be removed at any time.
        """
        if name in self.textures():
            super().remove_attribute(name)
            return
        self._require_alone("remove_attribute")
        self.attribute_buffer(name)
        del self.attributes[name]
        self.__dict__.pop(name, None)

    def _require_alone(self, call: str) -> None:
        if self.set is not None:
            raise ParameterError(
                f"{self.id()}: {call} must be called before load_dict: the mesh already belongs to a scene"
            )

    # ---- on the host -------------------------------------------------------------------

    def initialize(self) -> None:
        """Do nothing: a mesh is complete whenever its parameters are. For scripts written for Mitsuba."""

    recompute_bbox = initialize

    def recompute_vertex_normals(self) -> None:
        """Compute the vertex normals anew, as the angle-weighted means of the normals around them."""
        data = self.data()
        data.compute_normals()
        self.normals = data.normals
        self._forget()

    def merge(self, other: Mesh) -> Mesh:
        """A mesh of the triangles of both, with the material of this one.

        Normals and texture coordinates stay if both meshes have them, attributes don't.
        """
        mine, theirs = self.data(), other.data()
        pairs = [(mine.normals, theirs.normals), (mine.texcoords, theirs.texcoords)]
        normals, texcoords = (None if a is None or b is None else np.concatenate([a, b]) for a, b in pairs)
        positions = np.concatenate([mine.positions, theirs.positions])
        indices = np.concatenate([mine.indices, theirs.indices + np.uint32(len(mine.positions))])
        props = {} if self._bsdf is None else {"bsdf": self._bsdf}
        return Mesh(self.id(), positions, indices, normals, texcoords, {**props, "flip_normals": self.flip_normals})

    def _measure(self, areas: NDArray[np.float64] | None = None) -> None:
        """Begin to measure the mesh anew; `areas` are those of its triangles if they are known."""
        self._measures = Measures(self.positions, self.indices, areas)
        for name in ("area", "own_faces"):
            self.__dict__.pop(name, None)

    @cached_property
    def first_face(self) -> UInt32:
        """The number of the first face in the set."""
        return dr.opaque(UInt32, self._first_face)

    @cached_property
    def own_faces(self) -> UInt32:
        """The number of faces."""
        return dr.opaque(UInt32, len(self.indices))

    @cached_property
    def area(self) -> Float:  # type: ignore[override]
        """The area of all triangles."""
        return as_float(self._measures.area)

    def data(self) -> MeshData:
        """The mesh on the host, in world space."""
        attributes = {name: values for name, (values, _) in self.attributes.items()}
        return MeshData(self.positions, self.indices, self.normals, self.texcoords, attributes)

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

    def eval_parameterization(
        self, uv: Any, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface points with the texture coordinates (u, v), of several any one; `t` is 0, and infinite without.

        Raises:
            SceneError: The mesh has no texture coordinates.
        """
        if not self.has_vertex_texcoords():
            raise SceneError(f"{self.id()}: the mesh has no texture coordinates, so that they determine no point of it")
        uv = Point2f(uv)
        hit = self._unfolded().ray_intersect_preliminary(Ray3f(Point3f(uv.x, uv.y, -1), [0, 0, 1]), active=active)
        face, found = hit.prim_index, hit.is_valid()
        a, b, c = (self.vertex_position(corner, found) for corner in self.face_indices(face, found))
        u, v = hit.prim_uv
        p, n = dr.fma(a, 1 - u - v, dr.fma(b, u, c * v)), self.face_normal(face, found)
        # A ray from just above finds the triangle, and all that belongs to it.
        height = RAY_EPSILON * (1 + dr.max(dr.abs(p)))
        si: SurfaceInteraction3f = self.alone().ray_intersect(
            Ray3f(dr.fma(n, height, p), -n, maxt=2 * height), ray_flags, False, active=found
        )
        si.t = dr.select(si.is_valid(), Float(0), dr.inf)
        return si

    def _unfolded(self) -> Mesh:
        """The mesh in the plane of its texture coordinates."""
        key = self.vertex_texcoords, self.faces_parameter
        known = self.__dict__.get("_unfolded_mesh")
        if known is None or any(a is not b for a, b in zip(known[0], key, strict=True)):
            uv = np.array(dr.detach(self.vertex_texcoords), np.float32).reshape(-1, 2)
            flat = np.concatenate([uv, np.zeros((len(uv), 1), np.float32)], axis=1)
            known = key, Mesh(self.id(), flat, np.array(self.faces_parameter).reshape(-1, 3))
            self._unfolded_mesh = known
        mesh: Mesh = known[1]
        return mesh

    def draw_point(self, sample: Point2f) -> PositionSample3f:
        # As in Mitsuba, y chooses the triangle by area and is stretched for use within the triangle.
        if self.set is None:
            point: PositionSample3f = self.alone().shapes()[0].draw_point(sample)
            return point
        index, y = self.set.areas.sample(self.first_face, self.own_faces, self.area, sample.y)
        b = square_to_uniform_triangle(Point2f(sample.x, y))
        p, n, uv = self.set.point(self.first_face + index, b.x, b.y)
        return PositionSample3f.of(p, n, uv, dr.rcp(self.area))

    def silhouette_class(self) -> type[Silhouette] | None:
        from djpt.shapes.silhouettes.mesh import MeshSilhouette

        return MeshSilhouette if self.shape_type() == ShapeType.Mesh else None


class MeshFile(Mesh):
    """A mesh read from a file.

    Parameters: `filename`; `face_normals` (default false: without normals in the file, angle-weighted
    vertex normals are computed), `flip_normals` (default false), `flip_tex_coords` (v becomes 1 - v),
    `to_world`.
    """

    flips_texcoords: ClassVar[bool] = False
    """The default of `flip_tex_coords`."""

    def __init__(self, props: Properties) -> None:
        path = self.find(props)
        form = (type(self), self.part(props))
        where = f"{props.node}: {path.name}"
        read = read_once(props.string("filename"), form, lambda: self.read(self.load(props, path), where, props))
        # A copy of its own: the arrays may be shared, but aren't changed in place.
        data = copy.copy(read)
        data.attributes = dict(read.attributes)
        if props.boolean("flip_tex_coords", self.flips_texcoords) and data.texcoords is not None:
            data.texcoords = data.texcoords.copy()
            data.texcoords[:, 1] = 1 - data.texcoords[:, 1]
        self.adopt(data, props, compute_normals=True, source=path.name)

    @staticmethod
    def find(props: Properties) -> Path:
        """The file that `filename` names."""
        try:
            return resolve(props.string("filename"))
        except FileError as error:
            raise SceneError(f"{props.node}: 'filename': {error}") from None

    def part(self, props: Properties) -> Hashable:
        """A key that identifies one of several meshes in a file; by default a file holds one mesh."""
        return None

    @staticmethod
    def load(props: Properties, path: Path) -> bytes:
        """The file's contents."""
        try:
            return read_bytes(path)
        except FileError as error:
            raise SceneError(f"{props.node}: {error}") from None

    def read(self, data: bytes, where: str, props: Properties) -> MeshData:
        """The mesh in a file's contents, in object space; `where` names the file in messages."""
        raise NotImplementedError
