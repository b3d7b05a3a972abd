"""The stage of a USD file: meshes, instances, lights and cameras, read by the package usd-core.

Pixar, "Universal Scene Description", the schemas UsdGeom, UsdShade and UsdLux.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.errors import FileError, SceneError
from djpt.models.folder import Folder
from djpt.models.model import Camera, Matrix, Model, Part
from djpt.models.normal_maps import halves
from djpt.models.usd_materials import GREY, Materials, displayed
from djpt.shapes.meshes.data import MeshData, unit

__all__ = ["read_stage"]

MOST_PRIMS = 400_000
MOST_LAYERS = 1000


def read_stage(folder: Folder, name: str, time: float | None, texture_size: int) -> Model:
    """Read a USD file in this process; arguments and errors are those of `djpt.models.usd.read_usd`."""
    from pxr import Tf, Usd, UsdGeom

    path = str(folder.find(name))
    try:
        model = Model(name)
        check_layers(path, folder, model)
        opened = Usd.Stage.Open(path)
        at = Usd.TimeCode.EarliestTime() if time is None else Usd.TimeCode(time * opened.GetTimeCodesPerSecond())
        model.up = str(UsdGeom.GetStageUpAxis(opened)).lower()
        Reader(opened, at, model, Materials(folder, model, texture_size)).read()
    except (Tf.ErrorException, RuntimeError, ValueError, IndexError, TypeError) as error:
        if isinstance(error, (SceneError, FileError)):
            raise
        raise SceneError(f"{name}: can't be read: {said_by(error)}") from None
    return model


def said_by(error: Exception) -> str:
    """What an error of the library says, without where in its source."""
    try:
        text = " ".join(str(error).rpartition(" : '")[2].split()).strip("' ")
    except UnicodeDecodeError:  # it quotes the file
        text = ""
    return text[:300] or type(error).__name__


def check_layers(path: str, folder: Folder, model: Model) -> None:
    """Raise an error if a layer that the file is composed of lies outside of the folder, before it is read."""
    from pxr import Sdf

    name = model.name
    todo, seen = [path], set()
    while todo:
        current = todo.pop()
        if current in seen:
            continue
        seen.add(current)
        if len(seen) > MOST_LAYERS:
            raise SceneError(f"{name}: has more than {MOST_LAYERS} layers")
        outer = current.partition("[")[0]  # of a package, a.usdz[b.usda]
        if not folder.contains(outer):
            raise FileError(
                f"{name}: the layer '{current[:200]}' isn't in '{folder.root}', which a model may not leave"
            )
        if not os.path.isfile(outer):
            continue  # the library says so, and goes on without it
        suffix = current.rstrip("]").rpartition(".")[2]
        if current != path and (not suffix or Sdf.FileFormat.FindByExtension(suffix) is None):
            model.say(f"layers in the format '{suffix[:20]}', which usd-core doesn't read, are left out")
            continue
        layer = Sdf.Layer.FindOrOpen(current)
        if layer is None:
            raise SceneError(f"{name}: the layer '{os.path.basename(current)[:200]}' can't be read")
        todo += [layer.ComputeAbsolutePath(asset) for asset in layer.GetCompositionAssetDependencies() if asset]


class Reader:
    """One call of `read_stage`."""

    def __init__(self, stage: Any, time: Any, model: Model, materials: Materials) -> None:
        from pxr import UsdGeom

        self.stage, self.time, self.model, self.materials = stage, time, model, materials
        self.places = UsdGeom.XformCache(time)
        self.parts: dict[str, list[Part]] = {}
        """Parts of each mesh by its path, in the prototype for meshes of instances."""

    def read(self) -> None:
        """Read all prims."""
        from pxr import Usd

        prims = iter(Usd.PrimRange(self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for count, prim in enumerate(prims):
            if count > MOST_PRIMS:
                raise SceneError(f"{self.model.name}: has more than {MOST_PRIMS} prims, instances included")
            if prim.HasAuthoredMetadata("clips"):
                self.model.say("value clips are left out")
                prims.PruneChildren()
            elif self._add(prim):
                prims.PruneChildren()
        self.model.parts = [part for parts in self.parts.values() for part in parts if part.places]

    def _add(self, prim: Any) -> bool:
        """Add a prim; true if what is below it has been read with it, or isn't rendered."""
        from pxr import UsdGeom, UsdLux

        if not prim.IsA(UsdGeom.Imageable):
            return False
        imageable = UsdGeom.Imageable(prim)
        if imageable.ComputeVisibility(self.time) == UsdGeom.Tokens.invisible:
            return False
        if imageable.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
            return False
        if prim.IsA(UsdGeom.Mesh):
            self._add_mesh(prim, [self._place(prim)])
        elif prim.IsA(UsdGeom.PointInstancer):
            self._add_instancer(prim)
            return True
        elif prim.IsA(UsdGeom.Gprim):
            self.model.say(f"prims of the type '{prim.GetTypeName()}' are left out")
        elif prim.IsA(UsdGeom.Camera):
            self._add_camera(prim)
        elif prim.HasAPI(UsdLux.LightAPI):
            self._add_light(prim)
        elif prim.GetTypeName() == "SkelRoot":
            self.model.say("skins are left out: meshes stand as they are bound")
        return False

    def _place(self, prim: Any) -> Matrix:
        """From the prim's space to that of the stage, (4, 4)."""
        return np.array(self.places.GetLocalToWorldTransform(prim), np.float64).T

    def _value(self, attribute: Any, default: Any) -> Any:
        """The value of an attribute at the time."""
        value = attribute.Get(self.time) if attribute else None
        return default if value is None else value

    # ---- meshes ----------------------------------------------------------------------------

    def _add_mesh(self, prim: Any, places: list[Matrix]) -> None:
        source = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        key = str(source.GetPath())
        if key not in self.parts:
            self.parts[key] = self._parts(source)
        usable = [p for p in places if np.isfinite(p).all() and abs(np.linalg.det(p[:3, :3])) > 1e-30]
        for part in self.parts[key]:
            part.places.extend(usable)

    def _add_instancer(self, prim: Any) -> None:
        """The meshes of the prototypes of a point instancer, at each of its points."""
        from pxr import Usd, UsdGeom

        instancer = UsdGeom.PointInstancer(prim)
        targets = instancer.GetPrototypesRel().GetForwardedTargets()
        indices = np.array(self._value(instancer.GetProtoIndicesAttr(), []), np.int64)
        inner = instancer.ComputeInstanceTransformsAtTime(
            self.time, self.time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        )
        matrices = self._place(prim) @ np.array(inner, np.float64).reshape(-1, 4, 4).transpose(0, 2, 1)
        shown = np.array(instancer.ComputeMaskAtTime(self.time) or [True] * len(indices), bool)
        if len(matrices) != len(indices) or len(shown) != len(indices):
            raise SceneError(
                f"{self.model.name}: {prim.GetPath()} has {len(matrices)} places for {len(indices)} points"
            )
        for number, target in enumerate(targets):
            prototype = self.stage.GetPrimAtPath(target)
            own = matrices[(indices == number) & shown]
            if not prototype or not len(own):
                continue
            to_prototype = np.linalg.inv(self._place(prototype))
            for below in Usd.PrimRange(prototype, Usd.TraverseInstanceProxies()):
                if below.IsA(UsdGeom.Mesh):
                    self._add_mesh(below, list(own @ (to_prototype @ self._place(below))))

    def _parts(self, prim: Any) -> list[Part]:
        """The parts of a mesh, one for each material; without places yet."""
        from pxr import UsdGeom, UsdShade

        mesh = UsdGeom.Mesh(prim)
        points = np.array(self._value(mesh.GetPointsAttr(), []), np.float32).reshape(-1, 3)
        counts = np.array(self._value(mesh.GetFaceVertexCountsAttr(), []), np.int64)
        indices = np.array(self._value(mesh.GetFaceVertexIndicesAttr(), []), np.int64)
        if not len(points) or not len(counts):
            return []
        where = f"{self.model.name}: {prim.GetPath()}"
        if counts.min() < 0 or counts.sum() != len(indices):
            raise SceneError(f"{where} has {len(indices)} corners, its faces {counts.sum()}")
        if len(indices) and not 0 <= indices.min() <= indices.max() < len(points):
            raise SceneError(f"{where}: index {indices.max()} of {len(points)} points")
        corners, faces = triangulated(counts)
        if self._value(mesh.GetOrientationAttr(), "") == UsdGeom.Tokens.leftHanded:
            corners = corners[:, ::-1]
        subdivided = self._value(mesh.GetSubdivisionSchemeAttr(), "") != UsdGeom.Tokens.none
        normals = self._normals(mesh, points, corners, indices, counts, subdivided)
        api = UsdShade.MaterialBindingAPI(prim)
        groups = [(api.ComputeBoundMaterial()[0], np.ones(len(faces), bool))]
        for subset in api.GetMaterialBindSubsets():
            chosen = np.zeros(len(counts), bool)
            own = np.array(self._value(subset.GetIndicesAttr(), []), np.int64)
            chosen[own[(own >= 0) & (own < len(counts))]] = True
            groups[0][1][chosen[faces]] = False
            groups.append((UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0], chosen[faces]))
        plain = displayed(self._primvar(prim, "displayColor", 3, indices, counts))
        parts = []
        for material, kept in groups:
            if kept.any():
                surface = self.materials.made(material, plain)
                found = {name: self._primvar(prim, name, 2, indices, counts) for name in surface.uv_sets}
                sets = {name: upside_down(uv) for name, uv in found.items() if uv is not None}
                tints = {}
                if surface.tint is not None:
                    colors = self._primvar(prim, surface.tint, 3, indices, counts)
                    grey = np.full((len(indices), 3), GREY, np.float32)
                    tints["vertex_color"] = grey if colors is None else np.clip(colors, 0, 1)
                data, kept_corners = unified(points, indices, corners[kept], normals, [*sets.values(), *tints.values()])
                part = Part(str(prim.GetPath())[-100:], data, "", [], surface.emission)
                part.coordinates = {name: uv[kept_corners] for name, uv in sets.items()}
                part.tints = {name: values[kept_corners] for name, values in tints.items()}
                for half, mirrored in halves(part, surface.normal_set):
                    half.bsdf = self.materials.made(material, plain, mirrored).name
                    parts.append(half)
        return parts

    def _normals(self, mesh: Any, points: Any, corners: Any, indices: Any, counts: Any, subdivided: bool) -> Any:
        """The normals of the corners, (C, 3); None for those of faces."""
        found = self._primvar(mesh.GetPrim(), "normals", 3, indices, counts)
        if found is None:
            values = self._value(mesh.GetNormalsAttr(), None)
            found = spread(values, None, str(mesh.GetNormalsInterpolation()), 3, indices, counts)
        if subdivided:
            self.model.say("subdivision surfaces are rendered as their cages, with smooth normals")
            if found is None:
                rows = indices[corners]
                a, b, c = (points[rows[:, i]] for i in range(3))
                cross = np.cross(b - a, c - a)
                sums = [[np.bincount(column, x, len(points)) for x in cross.T] for column in rows.T]
                found = unit(np.sum(sums, axis=0).T)[indices]
        return found

    def _primvar(self, prim: Any, name: str, width: int, indices: Any, counts: Any) -> NDArray[np.float32] | None:
        """A primvar of the corners, (C, width); None if there is none that fits."""
        from pxr import UsdGeom

        primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar(name)
        if not primvar:
            return None
        values, chosen = self._value(primvar, None), None
        if primvar.IsIndexed():
            chosen = np.array(primvar.GetIndices(self.time), np.int64)
        return spread(values, chosen, str(primvar.GetInterpolation()), width, indices, counts)

    # ---- cameras and lights ----------------------------------------------------------------

    def _add_camera(self, prim: Any) -> None:
        from pxr import UsdGeom

        camera = UsdGeom.Camera(prim)
        place, name = self._place(prim), prim.GetName()[:100]
        aperture = float(self._value(camera.GetVerticalApertureAttr(), 15.2908))
        if self._value(camera.GetProjectionAttr(), "") == UsdGeom.Tokens.orthographic:
            # Apertures are in tenths of the unit of the stage.
            self.model.cameras.append(Camera(name, place, height=max(aperture / 10, 1e-6)))
            return
        length = max(float(self._value(camera.GetFocalLengthAttr(), 50.0)), 1e-3)
        self.model.cameras.append(Camera(name, place, fov=math.degrees(2 * math.atan(0.5 * aperture / length))))

    def _add_light(self, prim: Any) -> None:
        from pxr import UsdLux

        light = UsdLux.LightAPI(prim)
        strength = float(self._value(light.GetIntensityAttr(), 1.0)) * 2.0 ** float(
            np.clip(self._value(light.GetExposureAttr(), 0.0), -100, 100)
        )
        color = np.clip(strength * np.array(self._value(light.GetColorAttr(), (1, 1, 1)), np.float64), 0, 1e30)
        if self._value(light.GetEnableColorTemperatureAttr(), False):
            kelvin = float(self._value(light.GetColorTemperatureAttr(), 6500.0))
            color = color * np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin), np.float64)
        place = self._place(prim)
        if not color.any() or not np.isfinite(place).all() or abs(np.linalg.det(place[:3, :3])) < 1e-30:
            return
        node = self._light(prim, place, color, bool(self._value(light.GetNormalizeAttr(), False)))
        if node is not None:
            self.model.lights[f"light_{len(self.model.lights)}"] = node

    def _light(self, prim: Any, place: Matrix, color: Matrix, normalized: bool) -> dict[str, Any] | None:
        """The node of a light of a radiance, or of a power if it is normalised by its area."""
        from pxr import UsdLux

        def rgb(value: Matrix) -> dict[str, Any]:
            return {"type": "rgb", "value": [float(x) for x in value]}

        kind = str(prim.GetTypeName())
        if kind == "DistantLight":
            angle = math.radians(float(np.clip(self._value(UsdLux.DistantLight(prim).GetAngleAttr(), 0.53), 0, 180)))
            solid = 1.0 if normalized or not angle else math.pi * math.sin(0.5 * angle) ** 2
            ahead = place[:3, :3] @ np.array([0, 0, -1.0])
            direction = (ahead / np.linalg.norm(ahead)).tolist()
            return {"type": "directional", "direction": direction, "irradiance": rgb(color * solid)}
        if kind == "DomeLight":
            file = self._value(UsdLux.DomeLight(prim).GetTextureFileAttr(), None)
            found = self.materials.environment(file)
            if found is None:
                return {"type": "constant", "radiance": rgb(color)}
            if color.min() < color.max():
                self.model.say("the colour of a dome light's texture is scaled by its mean")
            place = place.copy()
            place[:3, 3] = 0
            return {"type": "envmap", **found, "scale": float(color.mean()), "to_world": ScalarTransform4f(place)}
        if kind == "SphereLight":
            sphere = UsdLux.SphereLight(prim)
            size = max(float(self._value(sphere.GetRadiusAttr(), 0.5)), 1e-6)
            if self._value(sphere.GetTreatAsPointAttr(), False):
                return {"type": "point", "position": place[:3, 3].tolist(), "intensity": rgb(color)}
            shape, matrix = "sphere", np.diag([size, size, size, 1.0])
        elif kind == "RectLight":
            rect = UsdLux.RectLight(prim)
            sides = [self._value(a, 1.0) for a in (rect.GetWidthAttr(), rect.GetHeightAttr())]
            # It shines along its -z.
            shape, matrix = "rectangle", np.diag([-0.5 * sides[0], 0.5 * sides[1], -1.0, 1.0])
        elif kind == "DiskLight":
            size = max(float(self._value(UsdLux.DiskLight(prim).GetRadiusAttr(), 0.5)), 1e-6)
            shape, matrix = "disk", np.diag([-size, size, -1.0, 1.0])
        else:
            self.model.say(f"lights of the type '{kind}' are left out")
            return None
        to_world = place @ matrix
        if normalized:
            color = color / area_of(shape, to_world)
        if not np.isfinite(to_world).all() or abs(np.linalg.det(to_world[:3, :3])) < 1e-30:
            return None
        if shape == "sphere":  # of one radius
            matrix = np.eye(4) * np.cbrt(abs(np.linalg.det(to_world[:3, :3])))
            matrix[:3, 3], matrix[3, 3] = to_world[:3, 3], 1
            to_world = matrix
        emitter = {"type": "area", "radiance": rgb(color)}
        return {"type": shape, "to_world": ScalarTransform4f(to_world), "emitter": emitter}


def area_of(shape: str, to_world: Matrix) -> float:
    """The area of a sphere, a rectangle or a disk of radius or half-length 1, moved by a matrix."""
    x, y, z = (float(np.linalg.norm(to_world[:3, i])) for i in range(3))
    areas = {"rectangle": 4 * x * y, "disk": math.pi * x * y, "sphere": 4 * math.pi * (x * y * z) ** (2 / 3)}
    return max(areas[shape], 1e-30)


def triangulated(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Fans of polygons: the corners of the triangles, (F, 3), and the polygon of each, (F,)."""
    starts = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    faces = np.repeat(np.arange(len(counts)), fans)
    within = np.arange(len(faces)) - np.repeat(np.cumsum(fans) - fans, fans)
    first = starts[faces]
    return np.stack([first, first + within + 1, first + within + 2], axis=1), faces


def spread(
    values: Any, chosen: Any, interpolation: str, width: int, indices: NDArray[np.int64], counts: NDArray[np.int64]
) -> NDArray[np.float32] | None:
    """Values of a mesh, by their interpolation, as values of its corners, (C, width); None if they don't fit."""
    if values is None:
        return None
    rows = np.array(values, np.float32)
    rows = rows.reshape(len(rows), -1)
    if chosen is not None:
        if len(chosen) and not 0 <= chosen.min() <= chosen.max() < len(rows):
            return None
        rows = rows[chosen]
    number = {
        "faceVarying": np.arange(len(indices)),
        "uniform": np.repeat(np.arange(len(counts)), counts),
        "constant": np.zeros(len(indices), np.int64),
    }.get(interpolation, indices)
    if rows.shape[1] != width or not len(rows) or (len(number) and number.max() >= len(rows)):
        return None
    return np.nan_to_num(rows[number], nan=0.0, posinf=0.0, neginf=0.0)


def upside_down(uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Texture coordinates whose v points down, for those whose v points up."""
    return np.ascontiguousarray(uv * (1, -1) + (0, 1), np.float32)


def unified(
    points: NDArray[np.float32], indices: NDArray[np.int64], corners: NDArray[np.int64], normals: Any, values: list[Any]
) -> tuple[MeshData, NDArray[np.int64]]:
    """The mesh of some corners, where those that are alike in all respects are one vertex; a corner of each vertex.

    Args:
        points: the points, (P, 3).
        indices: the points of all corners, (C,).
        corners: the corners of the triangles, (F, 3).
        normals: those of all corners, (C, 3), or None.
        values: what else corners have, (C, W) each.
    """
    chosen = np.zeros(len(indices), bool)
    chosen[corners] = True
    used = np.flatnonzero(chosen)
    columns: list[NDArray[np.uint32]] = [indices[used, None].astype(np.uint32)]
    # Bits, where zero has one sign.
    columns += [(x[used].astype(np.float32) + 0).view(np.uint32) for x in (normals, *values) if x is not None]
    first, inverse = distinct(np.hstack(columns))
    kept = used[first]
    place = np.zeros(len(indices), np.uint32)
    place[used] = inverse
    data = MeshData(np.ascontiguousarray(points[indices[kept]]), np.ascontiguousarray(place[corners], np.uint32))
    if normals is not None:
        data.normals = unit(normals[kept])
    return data, kept


def distinct(rows: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first of each kind of equal rows, (K,), and the kind of each row, (N,).

    They are sorted by a hash, which is eight times as fast, unless two different rows have the same one.
    """
    weights = np.random.default_rng(0).integers(2**63, 2**64, rows.shape[1], np.uint64) | np.uint64(1)
    keys = np.zeros(len(rows), np.uint64)
    for column, weight in zip(rows.T, weights, strict=True):
        keys += column * weight
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if (rows[first[inverse]] != rows).any():
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, inverse.ravel()
