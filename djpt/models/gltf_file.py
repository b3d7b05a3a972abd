"""The container of glTF 2.0: JSON, buffers, accessors and images, each checked before it is read.

Khronos, "glTF 2.0 Specification", version 2.0.1 (ISO/IEC 12113:2022).
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from djpt.core.limits import MAX_NUMBERS
from djpt.errors import FileError, SceneError
from djpt.models.folder import Folder
from djpt.models.images import decoded_image

__all__ = ["GltfFile", "integer", "numbers", "scalar"]

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}

MOST_DEEP = 64
"""The deepest nesting of the JSON text."""


class GltfFile:
    """A .gltf or .glb file.

    Args:
        data: the file's contents.
        folder: where other files are looked up.
        name: for messages.

    Raises:
        SceneError: the file isn't glTF 2.
    """

    def __init__(self, data: bytes, folder: Folder, name: str) -> None:
        self.folder, self.name = folder, name
        self.chunk: bytes | None = None
        """The binary chunk of a .glb file."""
        text = self._split(data) if data[:4] == b"glTF" else data
        try:
            self.json: Any = json.loads(text.decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise self.error(f"isn't glTF: {error}") from None
        if not isinstance(self.json, dict) or not isinstance(self.json.get("asset"), dict):
            raise self.error("isn't glTF: it has no 'asset'")
        version = str(self.json["asset"].get("version"))
        if not version.startswith("2"):
            raise self.error(f"is glTF {version[:20]}; version 2 can be read")
        self._buffers: dict[int, memoryview] = {}
        self._images: dict[int, NDArray[np.uint8]] = {}

    def _split(self, data: bytes) -> bytes:
        """The JSON of a .glb file, whose binary chunk is kept."""
        if len(data) < 20:
            raise self.error("ends within its header")
        _, version, _ = struct.unpack_from("<4sII", data)
        if version != 2:
            raise self.error(f"is glTF {version}; version 2 can be read")
        text, at = None, 12
        while at + 8 <= len(data):
            length, kind = struct.unpack_from("<II", data, at)
            if length > len(data) - at - 8:
                raise self.error(f"ends within a chunk of {length} bytes")
            body = data[at + 8 : at + 8 + length]
            if kind == 0x4E4F534A and text is None:
                text = body
            elif kind == 0x004E4942 and self.chunk is None:
                self.chunk = body
            at += 8 + length
        if text is None:
            raise self.error("has no JSON chunk")
        return text

    def error(self, problem: str) -> SceneError:
        """Make the error to raise for a problem of the file."""
        return SceneError(f"{self.name}: {problem}")

    # ---- JSON ------------------------------------------------------------------------------

    def list(self, key: str) -> list[Any]:
        """A list at the top, such as ``meshes``; empty if there is none."""
        found = self.json.get(key, [])
        if not isinstance(found, list):
            raise self.error(f"'{key}' must be a list")
        return found

    def at(self, key: str, index: Any) -> dict[str, Any]:
        """One object of a list at the top."""
        found = self.list(key)
        if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < len(found):
            raise self.error(f"{key}[{str(index)[:40]}] doesn't exist; there are {len(found)}")
        if not isinstance(found[index], dict):
            raise self.error(f"{key}[{index}] must be an object")
        return found[index]

    def extension(self, node: Any, name: str) -> dict[str, Any]:
        """The entries of an extension; empty if the object hasn't got it."""
        extensions = node.get("extensions", {}) if isinstance(node, dict) else {}
        found = extensions.get(name, {}) if isinstance(extensions, dict) else {}
        if not isinstance(found, dict):
            raise self.error(f"'{name}' must be an object")
        return found

    def has_extension(self, node: dict[str, Any], name: str) -> bool:
        """True if an object has an extension, also an empty one."""
        extensions = node.get("extensions")
        return isinstance(extensions, dict) and name in extensions

    # ---- bytes -----------------------------------------------------------------------------

    def bytes_of(self, uri: Any, what: str) -> bytes:
        """The contents of a ``data:`` address, or of a file in the folder."""
        if not isinstance(uri, str):
            raise self.error(f"{what}: 'uri' must be a string")
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                return unquote(body).encode("latin-1", "replace")
            try:
                return base64.b64decode(body)
            except (binascii.Error, ValueError):
                raise self.error(f"{what}: its base64 text is damaged") from None
        try:
            return self.folder.read(unquote(uri))
        except FileError as error:
            raise self.error(f"{what}: {error}") from None

    def buffer(self, index: Any) -> memoryview:
        """The contents of a buffer."""
        node = self.at("buffers", index)
        if index not in self._buffers:
            if "uri" in node:
                data = self.bytes_of(node["uri"], f"buffers[{index}]")
            elif index == 0 and self.chunk is not None:
                data = self.chunk
            else:
                raise self.error(f"buffers[{index}] has no contents")
            self._buffers[index] = memoryview(data)
        return self._buffers[index]

    def view(self, index: Any) -> tuple[memoryview, int]:
        """The bytes of a buffer view, and their stride (0: packed)."""
        node = self.at("bufferViews", index)
        for name in ("EXT_meshopt_compression", "KHR_meshopt_compression"):
            if self.has_extension(node, name):
                raise self.error(f"bufferViews[{index}] is compressed by '{name}', which can't be read")
        data = self.buffer(node.get("buffer"))
        start, length = (integer(node.get(key, 0)) for key in ("byteOffset", "byteLength"))
        if start < 0 or length < 0 or start + length > len(data):
            raise self.error(f"bufferViews[{index}] reaches over the end of its buffer of {len(data)} bytes")
        stride = integer(node.get("byteStride", 0))
        if not 0 <= stride <= 1024:
            raise self.error(f"bufferViews[{index}]: 'byteStride' can't be {stride}")
        return data[start : start + length], stride

    # ---- accessors -------------------------------------------------------------------------

    def accessor(self, index: Any, width: int | None = None) -> NDArray[Any]:
        """The numbers of an accessor, (N, C); normalised integers become floats.

        Args:
            index: which one.
            width: the required number of columns.
        """
        node = self.at("accessors", index)
        where = f"accessors[{index}]"
        kind, form = node.get("componentType"), node.get("type")
        if kind not in COMPONENTS or form not in WIDTHS:
            raise self.error(f"{where} has the type {str(form)[:20]} of {str(kind)[:20]}, which doesn't exist")
        columns, dtype = WIDTHS[form], np.dtype(COMPONENTS[kind])
        if width is not None and columns != width:
            raise self.error(f"{where} must have {width} columns, found {columns}")
        count = integer(node.get("count"))
        if count < 0 or count * columns > 2**30:
            raise self.error(f"{where}: 'count' can't be {count}")
        if "bufferView" in node:
            view, stride = self.view(node["bufferView"])
            result = self._rows(view, stride, integer(node.get("byteOffset", 0)), count, columns, dtype, where)
        elif count > MAX_NUMBERS:
            raise self.error(f"{where}: {count} zeros are too many")
        else:
            result = np.zeros((count, columns), dtype)
        if "sparse" in node:
            result = self._sparse(result, node["sparse"], where)
        if node.get("normalized") is True and dtype.kind in "iu":
            return np.maximum(result.astype(np.float32) / np.float32(np.iinfo(dtype).max), -1)
        return result

    def _rows(
        self, view: memoryview, stride: int, start: int, count: int, columns: int, dtype: np.dtype[Any], where: str
    ) -> NDArray[Any]:
        size = columns * dtype.itemsize
        stride = stride or size
        if count == 0:
            return np.zeros((0, columns), dtype)
        if start < 0 or stride < size or start + (count - 1) * stride + size > len(view):
            raise self.error(f"{where} reaches over the end of its view of {len(view)} bytes")
        rows = np.ndarray((count, columns), dtype, view, start, (stride, dtype.itemsize))
        return np.ascontiguousarray(rows)

    def _sparse(self, rows: NDArray[Any], node: Any, where: str) -> NDArray[Any]:
        """The rows with some of them replaced."""
        if not isinstance(node, dict) or not all(isinstance(node.get(key), dict) for key in ("indices", "values")):
            raise self.error(f"{where}: 'sparse' needs 'indices' and 'values'")
        count, indices, values = integer(node.get("count")), node["indices"], node["values"]
        kind = indices.get("componentType")
        if kind not in (5121, 5123, 5125):
            raise self.error(f"{where}: sparse indices can't be of type {str(kind)[:20]}")
        if not 0 <= count <= len(rows):
            raise self.error(f"{where}: {count} sparse rows of {len(rows)}")
        parts = []
        for part, columns, dtype in ((indices, 1, np.dtype(COMPONENTS[kind])), (values, rows.shape[1], rows.dtype)):
            view, _ = self.view(part.get("bufferView"))
            parts.append(self._rows(view, 0, integer(part.get("byteOffset", 0)), count, columns, dtype, where))
        if count and int(parts[0].max()) >= len(rows):
            raise self.error(f"{where}: sparse index {int(parts[0].max())} of {len(rows)} rows")
        result = rows.copy()
        result[parts[0][:, 0]] = parts[1]
        return result

    # ---- images ----------------------------------------------------------------------------

    def image(self, index: Any, largest: int) -> tuple[NDArray[np.uint8], bool]:
        """The pixels of an image, (H, W, 4), at most `largest` wide and high, and whether they were made smaller."""
        if index in self._images:
            return self._images[index], False
        node = self.at("images", index)
        where = f"images[{index}]"
        data = (
            bytes(self.view(node["bufferView"])[0]) if "bufferView" in node else self.bytes_of(node.get("uri"), where)
        )
        pixels, smaller = decoded_image(data, largest, f"{self.name}: {where}")
        self._images[index] = pixels
        return pixels, smaller


def integer(value: Any) -> int:
    """A whole number; -1 for anything else."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53 else -1


def scalar(value: Any, default: float) -> float:
    """A finite number; `default` for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return default
    return float(value) if math.isfinite(value) and abs(value) < 1e30 else default


def numbers(value: Any, default: tuple[float, ...]) -> NDArray[np.float64]:
    """Finite numbers, as many as `default` has; `default` for anything else."""
    if isinstance(value, list) and len(value) == len(default):
        return np.array([scalar(x, d) for x, d in zip(value, default, strict=True)])
    return np.array(default, np.float64)
