"""A small glTF file, made here: a quad with a texture, to which tests add what they are about."""

from __future__ import annotations

import base64
import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

__all__ = ["Quad", "glb", "png", "quad"]


class Quad:
    """The JSON of a file, and its buffer, which grows."""

    def __init__(self) -> None:
        self.data = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}]}
        self.json |= {"bufferViews": [], "accessors": [], "materials": [{}]}
        self.material: dict[str, Any] = self.json["materials"][0]
        positions = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        attributes = {
            "POSITION": self.accessor(positions, "VEC3"),
            "NORMAL": self.accessor(np.float32([[0, 0, 1]] * 4), "VEC3"),
            "TEXCOORD_0": self.accessor(np.float32([[0, 1], [1, 1], [1, 0], [0, 0]]), "VEC2"),
        }
        indices = self.accessor(np.uint16([0, 1, 2, 0, 2, 3]), "SCALAR")
        self.primitive: dict[str, Any] = {"attributes": attributes, "indices": indices, "material": 0}
        self.node: dict[str, Any] = {"mesh": 0}
        self.json |= {"meshes": [{"primitives": [self.primitive]}], "nodes": [self.node]}

    def view(self, data: bytes) -> int:
        """Add bytes; returns the number of the view."""
        self.data += b"\0" * (-len(self.data) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)})
        self.data += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, rows: Any, kind: str, **entries: Any) -> int:
        """Add numbers; returns the number of the accessor."""
        codes = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
        view = self.view(rows.tobytes())
        count = len(rows) if kind == "SCALAR" else rows.reshape(-1, rows.shape[-1]).shape[0]
        if kind == "MAT4":
            count = rows.size // 16
        node = {"bufferView": view, "componentType": codes[rows.dtype.name], "count": count, "type": kind}
        self.json["accessors"].append({**node, **entries})
        return len(self.json["accessors"]) - 1

    def texture(self, pixels: Any, **sampler: Any) -> dict[str, Any]:
        """Add a texture; returns the reference to it."""
        self.json.setdefault("images", []).append({"bufferView": self.view(png(pixels)), "mimeType": "image/png"})
        self.json.setdefault("samplers", []).append(sampler)
        textures = self.json.setdefault("textures", [])
        textures.append({"source": len(self.json["images"]) - 1, "sampler": len(self.json["samplers"]) - 1})
        return {"index": len(textures) - 1}

    def glb(self) -> bytes:
        """The file as .glb."""
        return glb(self.json | {"buffers": [{"byteLength": len(self.data)}]}, self.data)

    def gltf(self) -> bytes:
        """The file as .gltf with its buffer in the text."""
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        return json.dumps(self.json | {"buffers": [{"byteLength": len(self.data), "uri": uri}]}).encode()


def quad() -> Quad:
    """A quad from (-1, -1, 0) to (1, 1, 0) that faces +z."""
    return Quad()


def png(pixels: Any) -> bytes:
    """Pixels as a PNG file."""
    file = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
    return file.getvalue()


def glb(description: dict[str, Any], data: bytes) -> bytes:
    """A .glb file of its two chunks."""
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
