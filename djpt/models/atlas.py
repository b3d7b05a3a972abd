"""One set of texture coordinates for every mesh.

Files give meshes several sets, and multiply textures by colours of vertices; a mesh of a scene has one set, and a
texture no factor that varies. Where a material needs more, its textures are resampled into an atlas: a square in
which every triangle has texels of its own.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from djpt.models.model import Matrix, Model, Part
from djpt.models.textures import linear, stored
from djpt.shapes.meshes.data import MeshData, unit

__all__ = ["resolve_coordinates"]

LARGEST = 4096
"""The most texels of an atlas along its sides."""
SMALLEST_CELL = 8
"""The fewest texels of a cell along its sides; two triangles share it."""
BORDER = 4
"""Texels of a cell that only lookups between texels reach."""
INWARD = 1e-4
"""How far points are moved to the middle of their triangle: on its border a texture may begin anew."""
SHARP = 4
"""Texels of the atlas for one that is a square."""
MOST_LOOKUPS = 2**25
"""The most lookups for an atlas: a texel takes the mean of several where cells are too small for the texture."""
CHUNK = 2**20
"""The texels that are made at a time."""
MOST_PERIODS = 16
"""The most repetitions of a texture along a side of a triangle that get texels of their own."""
MOST_TRIANGLES = 2 * (LARGEST // SMALLEST_CELL) ** 2
"""The most triangles of a mesh with an atlas."""


Change = Callable[[dict[str, Any], bool], dict[str, Any]]
"""From a bitmap, and whether it is a normal map, to what stands in its place."""


def resolve_coordinates(model: Model) -> None:
    """Give the mesh of every part the set of texture coordinates that its textures need, and take their tags away."""
    resolved = {name: resolve(node, untagged) for name, node in model.nodes.items()}
    for part in model.parts:
        trees = [tree for tree in (model.nodes[part.bsdf], part.emission) if tree is not None]
        leaves = [leaf for tree in trees for leaf in leaves_in(tree)]
        for leaf in leaves:
            if leaf["type"] != "bitmap" and leaf.get("tint") in part.tints:
                colors = np.clip(part.tints[leaf["tint"]] * np.float32(leaf["value"]), 0, 1)
                part.mesh.attributes[leaf["tint"]] = np.ascontiguousarray(colors, np.float32)
        bitmaps = [leaf for leaf in leaves if leaf["type"] == "bitmap"]
        used = list(dict.fromkeys(bitmap["uv_set"] for bitmap in bitmaps if "uv_set" in bitmap))
        name = used[0] if used else next(iter(part.coordinates), "")
        if name in part.coordinates:
            part.mesh.texcoords = part.coordinates[name]
        change: Change = untagged
        if len(used) > 1 or any(bitmap.get("tint") in part.tints for bitmap in bitmaps):
            if len(part.mesh.indices) <= MOST_TRIANGLES:
                atlas = Atlas(part, bitmaps)
                part.mesh, change = atlas.mesh, atlas.texture
            else:
                model.say("large meshes have one set of texture coordinates, and vertex colours on textures their mean")
                change = functools.partial(averaged, part=part)
            node, part.bsdf = model.nodes[part.bsdf], f"{part.bsdf}_{len(resolved)}"
            resolved[part.bsdf] = resolve(node, change)
        if part.emission is not None:
            part.emission = resolve(part.emission, change)
        part.coordinates, part.tints = {}, {}
    used_names = {name for part in model.parts for name in (part.bsdf, part.interior)}
    model.nodes = {name: node for name, node in resolved.items() if name in used_names}


# ---- trees of nodes --------------------------------------------------------------------------


def leaves_in(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The textures and colours in a node, or the node if it is one."""
    if node.get("type") in ("bitmap", "rgb", "uniform"):
        yield node
    for value in node.values():
        if isinstance(value, dict):
            yield from leaves_in(value)


def resolve(node: dict[str, Any], change: Change, name: str = "") -> Any:
    """A node whose bitmaps are changed, told whether they are normal maps, and whose tinted colours are attributes."""
    if node.get("type") == "bitmap":
        return change(node, name == "normalmap")
    if "tint" in node:
        return {"type": "mesh_attribute", "name": node["tint"]}
    return {key: resolve(value, change, key) if isinstance(value, dict) else value for key, value in node.items()}


def untagged(bitmap: dict[str, Any], is_normal: bool = False) -> dict[str, Any]:
    """A bitmap without the entries that are for this file only."""
    return {key: value for key, value in bitmap.items() if key not in ("uv_set", "tint")}


def averaged(bitmap: dict[str, Any], is_normal: bool, part: Part) -> dict[str, Any]:
    """A bitmap multiplied by the mean of its tint."""
    if bitmap.get("tint") not in part.tints:
        return untagged(bitmap)
    return untagged(bitmap) | stored(linear(bitmap) * part.tints[bitmap["tint"]].mean(axis=0), bitmap)


# ---- pixels ----------------------------------------------------------------------------------


def wrapped(index: NDArray[np.int64], count: int, mode: str) -> NDArray[np.int64]:
    """The texels that stand for those outside of an image."""
    if mode == "clamp":
        return np.clip(index, 0, count - 1)
    if mode == "mirror":
        period = index % (2 * count)
        return np.minimum(period, 2 * count - 1 - period)
    return index % count


def looked_up(bitmap: dict[str, Any], pixels: NDArray[np.float32], uv: Matrix) -> NDArray[np.float32]:
    """The values of a bitmap at texture coordinates, (N, 2); (N, C)."""
    height, width = pixels.shape[:2]
    if "to_uv" in bitmap:
        matrix = np.asarray(bitmap["to_uv"].matrix)
        uv = uv @ matrix[:2, :2].T + matrix[:2, 3]
    at = np.clip(uv, -1e6, 1e6) * (width, height)
    mode = bitmap["wrap_mode"]
    if bitmap.get("filter_type") == "nearest":
        x, y = np.floor(at).astype(np.int64).T
        return pixels[wrapped(y, height, mode), wrapped(x, width, mode)]
    at = at - 0.5
    low = np.floor(at).astype(np.int64)
    right, down = (at - low).T.astype(np.float32)[..., None]
    columns = [wrapped(low[:, 0] + i, width, mode) for i in (0, 1)]
    rows = [wrapped(low[:, 1] + i, height, mode) for i in (0, 1)]
    above, below = ((1 - right) * pixels[row, columns[0]] + right * pixels[row, columns[1]] for row in rows)
    return (1 - down) * above + down * below


# ---- the atlas -------------------------------------------------------------------------------


@dataclass
class Rows:
    """Some rows of texels of the atlas."""

    face: NDArray[np.int64]
    """The triangle of each texel, (N,)."""
    local: Matrix
    """Barycentric coordinates of its centre for the second and the third corner, (N, 2)."""


class Atlas:
    """The atlas of a part.

    It has cells in rows and columns, all of the same size, each of two triangles: texel (x, y) of a cell of n x n is
    the first one's where x + y < n, and the second one's, turned by half a turn, elsewhere. Corners lie at centres of
    texels, so that lookups between texels meet none of another triangle.

    Args:
        part: the part.
        bitmaps: its textures.
    """

    def __init__(self, part: Part, bitmaps: list[dict[str, Any]]) -> None:
        self.part, self.source = part, part.mesh
        faces = len(part.mesh.indices)
        self.cells = math.ceil(math.sqrt(math.ceil(faces / 2)))
        """Cells along both sides."""
        needed = max((self._texels(bitmap) for bitmap in bitmaps), default=1.0)
        self.size = int(np.clip(math.ceil(needed) + BORDER, SMALLEST_CELL, LARGEST // self.cells))
        """Texels of a cell along both sides."""
        most = math.isqrt(MOST_LOOKUPS) // (self.cells * self.size)
        self.samples = int(np.clip(math.ceil(needed / self.size), 1, most))
        self.mesh = self._mesh()
        self._made: dict[Any, dict[str, Any]] = {}

    def texture(self, bitmap: dict[str, Any], is_normal: bool) -> dict[str, Any]:
        """The texture that stands for one of the part's in the atlas."""
        key = (id(bitmap), is_normal)
        if key not in self._made:
            self._made[key] = self._resampled(bitmap, is_normal)
        return self._made[key]

    def _coordinates(self, bitmap: dict[str, Any]) -> Matrix:
        """The texture coordinates of a bitmap at the corners, (F, 3, 2); zero without any."""
        found = self.part.coordinates.get(bitmap.get("uv_set", ""))
        if found is None:
            return np.zeros((len(self.source.indices), 3, 2))
        corners: Matrix = found.astype(np.float64)[self.source.indices]
        return corners

    def _texels(self, bitmap: dict[str, Any]) -> float:
        """The texels of a bitmap along the longest side of a triangle."""
        uv = self._coordinates(bitmap)
        matrix = np.asarray(bitmap["to_uv"].matrix)[:2, :2] if "to_uv" in bitmap else np.eye(2)
        height, width = bitmap["bitmap" if "bitmap" in bitmap else "data"].shape[:2]
        sides = (uv - np.roll(uv, 1, axis=1)) @ matrix.T * (width, height)
        longest = float(np.sqrt((sides**2).sum(axis=-1)).max(initial=1.0))
        longest = min(longest, MOST_PERIODS * max(width, height))
        return longest * (SHARP if bitmap.get("filter_type") == "nearest" else 1)

    def _mesh(self) -> MeshData:
        """The mesh, whose triangles share no vertices, with its place in the atlas."""
        old = self.source
        count = len(old.indices)
        corners = old.indices.ravel()
        side = self.size - BORDER
        first = np.array([[0.5, 0.5], [0.5 + side, 0.5], [0.5, 0.5 + side]])
        cell, second = np.arange(count) // 2, np.arange(count) % 2 == 1
        within = np.where(second[:, None, None], self.size - first, first)
        start = np.stack([cell % self.cells, cell // self.cells], axis=1) * self.size
        mesh = MeshData(old.positions[corners], np.arange(3 * count, dtype=np.uint32).reshape(-1, 3))
        mesh.normals = None if old.normals is None else old.normals[corners]
        uv = (within + start[:, None]) / (self.cells * self.size)
        mesh.texcoords = uv.reshape(-1, 2).astype(np.float32)
        mesh.attributes = {
            name: values if name.startswith("face_") else values[corners] for name, values in old.attributes.items()
        }
        return mesh

    def _texel_rows(self, shift: tuple[float, float]) -> Iterator[Rows]:
        """The texels from top to bottom, at points by which they are shifted from their centres."""
        width = self.cells * self.size
        step = max(1, CHUNK // width)
        x = np.arange(width)
        for start in range(0, width, step):
            y = np.arange(start, min(start + step, width))[:, None]
            column, row = np.broadcast_arrays(x % self.size, y % self.size)
            second = column + row >= self.size
            face = 2 * (x // self.size + y // self.size * self.cells) + second
            local = np.stack([column + shift[0], row + shift[1]], axis=-1)
            local = np.where(second[..., None], self.size - 1 - local, local) / (self.size - BORDER)
            local = local * (1 - INWARD) + INWARD / 3
            yield Rows(np.minimum(face, len(self.source.indices) - 1).ravel(), local.reshape(-1, 2))

    def _resampled(self, bitmap: dict[str, Any], is_normal: bool) -> dict[str, Any]:
        """A texture, resampled."""
        pixels, corners = linear(bitmap), self._coordinates(bitmap)
        edges = corners[:, 1:] - corners[:, :1]
        turns = self._turns(bitmap) if is_normal else None
        tint = self.part.tints.get(bitmap.get("tint", ""))
        colors = None if tint is None else tint[self.source.indices]
        width, samples = self.cells * self.size, self.samples
        channels = max(pixels.shape[2], 1 if tint is None else tint.shape[1])
        result = np.zeros((width * width, channels), np.float32)
        shifts = (np.arange(samples) + 0.5) / samples - 0.5
        for shift in [(float(x), float(y)) for x in shifts for y in shifts]:
            done = 0
            for rows in self._texel_rows(shift):
                face, local = rows.face, rows.local
                uv = corners[face, 0] + np.einsum("ni,nij->nj", local, edges[face])
                values = looked_up(bitmap, pixels, uv)
                if turns is not None:
                    values = turned(values, turns[face])
                if colors is not None:
                    a, b, c = (colors[face, i] for i in range(3))
                    values = values * np.clip(a + local[:, :1] * (b - a) + local[:, 1:] * (c - a), 0, 1)
                result[done : done + len(face)] += values
                done += len(face)
        means = result.reshape(width, width, channels) / samples**2
        return {"type": "bitmap", "wrap_mode": "clamp", **stored(means, bitmap)}

    def _turns(self, bitmap: dict[str, Any]) -> Matrix:
        """Of each triangle, the direction of growing u of a bitmap, by cosine and sine in the frame of the atlas."""
        mesh = self.source
        points = mesh.positions.astype(np.float64)[mesh.indices]
        e, f = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        normal = unit(np.cross(e, f)).astype(np.float64)
        if mesh.normals is not None:  # the frame stands on the side of the normals of the vertices
            above = np.einsum("ij,ij->i", normal, mesh.normals[mesh.indices].sum(axis=1)) >= 0
            normal *= np.where(above, 1, -1)[:, None]
        uv = self._coordinates(bitmap)
        p, q = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        along = (q[:, 1:] * e - p[:, 1:] * f) * np.sign(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])[:, None]
        old = unit(along).astype(np.float64)
        side = np.where(np.arange(len(e)) % 2 == 1, -1, 1)[:, None]
        new = unit(side * e).astype(np.float64)
        cosine, sine = (old * new).sum(axis=1), (old * np.cross(normal, new)).sum(axis=1)
        known = np.abs(cosine) + np.abs(sine) > 0.5
        return np.stack([np.where(known, cosine, 1), np.where(known, sine, 0)], axis=1)


def turned(values: NDArray[np.float32], turns: Matrix) -> NDArray[np.float32]:
    """Colours of a normal map, (N, 3), whose directions are turned around the surface's normal."""
    x, y = (2 * values[:, i] - 1 for i in (0, 1))
    c, s = turns.T
    result = values.copy()
    result[:, 0], result[:, 1] = 0.5 + 0.5 * (c * x - s * y), 0.5 + 0.5 * (s * x + c * y)
    return result
