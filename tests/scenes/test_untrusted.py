"""Scenes of strangers: which files they can read, and how much time and memory they can take."""

from __future__ import annotations

import os
import socket
import struct
import sys
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.limits import MAX_FILES, MAX_NAME, MAX_NODES, MAX_PARTS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="has no pipes and devices among its files")

SECRET = "alice:x:0:0:hidden"


def pipe(path: Path) -> None:
    os.mkfifo(path)


def server(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


IRREGULAR: list[tuple[str, Callable[[Path], None]]] = [
    ("a folder", Path.mkdir),
    ("a pipe", pipe),
    ("a socket", server),
    ("a device", device),
]
NAMES: dict[str, Callable[[str], Any]] = {
    "obj": lambda name: djpt.load_dict({"type": "obj", "filename": name}),
    "ply": lambda name: djpt.load_dict({"type": "ply", "filename": name}),
    "txt": lambda name: djpt.load_dict({"type": "linearcurve", "filename": name}),
    "hdr": lambda name: djpt.load_dict({"type": "bitmap", "filename": name}),
    "pfm": lambda name: djpt.load_dict({"type": "bitmap", "filename": name}),
    "serialized": lambda name: djpt.load_dict({"type": "serialized", "filename": name}),
    "vol": lambda name: djpt.load_dict({"type": "sdfgrid", "filename": name}),
    "exr": lambda name: djpt.load_dict({"type": "envmap", "filename": name}),
    "png": lambda name: djpt.load_dict({"type": "bitmap", "filename": name}),
    "npy": lambda name: djpt.load_dict({"type": "bitmap", "filename": name}),
    "spd": lambda name: djpt.load_string(
        f'<bsdf version="3.0.0" type="diffuse"><spectrum name="reflectance" filename="{name}"/></bsdf>'
    ),
    "xml": lambda name: djpt.load_string(f'<scene version="3.0.0"><include filename="{name}"/></scene>'),
    "scene.xml": djpt.load_file,
    "read.exr": djpt.read,
}
"""What reads a file, by an extension."""


@pytest.mark.parametrize(("kind", "make"), IRREGULAR, ids=[kind for kind, _ in IRREGULAR])
@pytest.mark.parametrize("suffix", NAMES)
def test_only_regular_files_are_read(tmp_path: Path, suffix: str, kind: str, make: Callable[[Path], None]) -> None:
    path = tmp_path / f"a.{suffix}"
    make(path)
    with pytest.raises(djpt.DjptError, match=f"it is {kind}, not a regular file"):
        NAMES[suffix](str(path))


@pytest.mark.parametrize("suffix", [name for name in NAMES if name not in ("scene.xml", "read.exr")])
def test_messages_dont_quote_other_files(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    path.write_text(f"{SECRET} 1 2 3\n" * 3)
    with pytest.raises(djpt.DjptError) as caught:
        NAMES[suffix](str(path))
    assert "alice" not in str(caught.value)
    assert "hidden" not in str(caught.value)


@pytest.mark.parametrize("begin", ["v 1 ", "v ", "vn ", "vt ", "f 1 2 ", ""])
def test_lines_of_other_files_arent_quoted(tmp_path: Path, begin: str) -> None:
    """A line that a format understands by its first word may hold anything in the others."""
    for kind, name in (("obj", "a.obj"), ("bsplinecurve", "a.txt")):
        (tmp_path / name).write_text(f"{begin}token = {SECRET}\n")
        with pytest.raises(djpt.DjptError) as caught:
            djpt.load_dict({"type": kind, "filename": str(tmp_path / name)})
        assert "alice" not in str(caught.value)


@pytest.mark.parametrize(
    "header",
    ["ply\nformat ascii 1.0\n{} password\n", "ply\n{} {}\n", "ply\nelement v 1\nproperty list float int\t{} {}\n"],
)
def test_headers_of_other_files_arent_quoted(tmp_path: Path, header: str) -> None:
    path = tmp_path / "a.ply"
    path.write_text(header.format("key", SECRET))
    with pytest.raises(djpt.SceneError) as caught:
        djpt.load_dict({"type": "ply", "filename": str(path)})
    assert "alice" not in str(caught.value) and "password" not in str(caught.value)


def test_the_header_of_a_radiance_picture_isnt_quoted(tmp_path: Path) -> None:
    path = tmp_path / "a.hdr"
    path.write_text(f"#?\n\n{SECRET}\n")
    with pytest.raises(djpt.SceneError) as caught:
        djpt.load_dict({"type": "bitmap", "filename": str(path)})
    assert "alice" not in str(caught.value)


# ---- a root --------------------------------------------------------------------------------


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """Two folders, `inside` with a scene, `outside` with what it may not read."""
    for name in ("inside", "outside"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "m.xml").write_text('<bsdf version="3.0.0" type="diffuse"/>')
        (tmp_path / name / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "inside" / "link.xml").symlink_to(tmp_path / "outside" / "m.xml")
    (tmp_path / "inside" / "folder").symlink_to(tmp_path / "outside")
    return tmp_path


OUTSIDE = ["../outside/m.xml", "{outside}/m.xml", "link.xml", "folder/m.xml", "../inside/../outside/m.xml"]


def scene(house: Path, content: str) -> Path:
    path = house / "inside" / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{content}</scene>')
    return path


@pytest.mark.parametrize("name", OUTSIDE)
def test_an_untrusted_scene_reads_nothing_outside_of_its_folder(house: Path, name: str) -> None:
    name = name.format(outside=house / "outside")
    path = scene(house, f'<include filename="{name}"/>')
    assert djpt.load_file(path) is not None
    with pytest.raises(djpt.SceneError, match=r"scene\.xml:1: <include>: '.*' isn't in '.*inside', which this scene"):
        djpt.load_file(path, trusted=False)
    with pytest.raises(djpt.SceneError, match="which this scene may not leave"):
        djpt.load_file(
            scene(house, f'<shape type="obj"><string name="filename" value="{name}"/></shape>'), trusted=False
        )
    assert djpt.load_file(scene(house, f'<include filename="{name}"/>'), trusted=False, root=house) is not None


def test_a_missing_file_and_one_outside_look_the_same(house: Path) -> None:
    messages = []
    for name in ("../outside/m.xml", "../outside/n.xml"):
        with pytest.raises(djpt.SceneError) as caught:
            djpt.load_file(scene(house, f'<include filename="{name}"/>'), trusted=False)
        messages.append(str(caught.value).replace(name, ""))
    assert messages[0] == messages[1]


def test_an_untrusted_scene_reads_what_is_inside(house: Path) -> None:
    content = '<include filename="m.xml"/><shape type="obj"><string name="filename" value="m.obj"/></shape>'
    assert len(djpt.load_file(scene(house, content), trusted=False).shapes()) == 1
    read = djpt.xml.read_file(scene(house, content), trusted=False)
    # A dict that was read stays confined when it is changed.
    read["mesh"] = {"type": "obj", "filename": str(house / "outside" / "m.obj")}
    with pytest.raises(djpt.SceneError, match="which this scene may not leave"):
        djpt.load_dict(read)


def test_texts_are_confined_to_the_working_directory(house: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(house / "inside")
    text = '<scene version="3.0.0"><include filename="{}"/></scene>'
    assert djpt.load_string(text.format("m.xml"), trusted=False) is not None
    with pytest.raises(djpt.SceneError, match="which this scene may not leave"):
        djpt.load_string(text.format("../outside/m.xml"), trusted=False)


def test_a_root_must_be_a_folder_of_an_untrusted_scene(house: Path) -> None:
    path = scene(house, "")
    with pytest.raises(djpt.FileError, match="'root' must be a folder"):
        djpt.load_file(path, trusted=False, root=path)
    with pytest.raises(djpt.SceneError, match="set trusted=False, too"):
        djpt.load_file(path, root=house)


# ---- time and memory -----------------------------------------------------------------------


def test_nodes_are_counted_wherever_they_stand() -> None:
    node: dict[str, Any] = {"type": "diffuse"}
    for _ in range(28):
        node = {"type": "twosided", "a": node, "b": node}
    with pytest.raises(djpt.SceneError, match=f"more than {MAX_NODES} nodes"):
        djpt.load_dict({"type": "scene", "m": node})


def test_levels_of_two_references_each_dont_grow_exponentially() -> None:
    chain: dict[str, Any] = {"type": "scene", "m12": {"type": "diffuse"}}
    for i in range(12):
        below = {"type": "ref", "id": f"m{i + 1}"}
        chain[f"m{i}"] = {"type": "blendbsdf", "a": below, "b": below}
    with pytest.raises(djpt.SceneError, match=rf"more than {MAX_PARTS} plugins in one"):
        djpt.load_dict(chain)


def test_a_material_of_many_parts_can_be_used() -> None:
    below: dict[str, Any] = {"type": "diffuse"}
    for _ in range(6):
        below = {"type": "blendbsdf", "weight": 0.5, "a": below, "b": below}
    assert djpt.load_dict(below).class_name() == "BlendBSDF"


def test_objects_of_included_files_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("djpt.description.xml.reader.MAX_NODES", 1000)
    (tmp_path / "m.xml").write_text('<scene version="3.0.0">' + '<bsdf type="diffuse"/>' * 100 + "</scene>")
    main = tmp_path / "main.xml"
    main.write_text('<scene version="3.0.0">' + '<include filename="m.xml"/>' * 20 + "</scene>")
    with pytest.raises(djpt.SceneError, match=r"m\.xml:1: <bsdf>: more than 1000 objects"):
        djpt.load_file(main)


def test_files_are_counted(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text('<scene version="3.0.0"/>')
    main = tmp_path / "main.xml"
    main.write_text('<scene version="3.0.0">' + '<include filename="m.xml"/>' * (MAX_FILES + 1) + "</scene>")
    with pytest.raises(djpt.SceneError, match=f"more than {MAX_FILES} files"):
        djpt.load_file(main)


@pytest.mark.parametrize("name", ["x" * (MAX_NAME + 1), "x" * 10**7])
def test_names_are_bounded(name: str) -> None:
    for description in ({name: {"type": "diffuse"}}, {"m": {"type": "diffuse", "id": name}}):
        with pytest.raises(djpt.SceneError) as caught:
            djpt.load_dict({"type": "scene", **description})
        assert len(str(caught.value)) < 500
    with pytest.raises(djpt.SceneError) as caught:
        djpt.load_dict({"type": "obj", "filename": name})
    assert len(str(caught.value)) < 500


def test_suggestions_take_no_time_where_names_are_many_and_long() -> None:
    description: dict[str, Any] = {f"{i:05}{'x' * 900}": {"type": "diffuse"} for i in range(3000)}
    with pytest.raises(djpt.SceneError, match="nothing has the id 'yxxx") as caught:
        djpt.load_dict({"type": "scene", **description, "r": {"type": "ref", "id": "y" + "x" * 900}})
    assert len(str(caught.value)) < 100_000


def test_surface_properties_are_counted() -> None:
    aovs = ",".join(f"a{i}:depth" for i in range(100_000))
    with pytest.raises(djpt.SceneError, match="'aovs' can have up to 256 variables, found 100000"):
        djpt.load_dict({"type": "aov", "aovs": aovs})


@pytest.mark.parametrize("value", ["true", 1, None, djpt.Float(1)], ids=str)
def test_trust_is_given_or_not(house: Path, value: Any) -> None:
    with pytest.raises(djpt.SceneError, match="'trusted' must be True or False"):
        djpt.load_file(scene(house, ""), trusted=value)


# ---- files that claim too much -------------------------------------------------------------

HEADER = "ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ("9" * 5000, "1", "line 3: can't understand this line of 'element'"),
        ("4000000000", "1", "row 0 of the element|the file is cut short, in row 3 of 4000000000"),
        ("9" * 18, "1", "row 0 of the element|the file is cut short, in row 3 of 999999999999999999"),
        ("3", "0", "the mesh is empty: 3 vertices, no triangle"),
    ],
)
def test_a_header_allocates_nothing(tmp_path: Path, form: str, vertices: str, faces: str, message: str) -> None:
    path = tmp_path / "a.ply"
    body = b"0 0 0 1 0 0 0 1 0\n" if form == "ascii" else bytes(36)
    path.write_bytes((HEADER + FACES).format(form=form, vertices=vertices, faces=faces).encode() + body)
    with pytest.raises(djpt.SceneError, match=message):
        djpt.load_dict({"type": "ply", "filename": str(path)})


@pytest.mark.parametrize("shape", [(0, 0, 3), (4, 0, 3), (0, 4, 1)])
def test_images_without_pixels(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(shape, np.float32))
    with pytest.raises(djpt.SceneError, match="must have at least one pixel"):
        djpt.load_dict({"type": "bitmap", "filename": str(path)})


@pytest.mark.parametrize("kind", ["ply", "ellipsoids", "ellipsoidsmesh"])
def test_a_header_without_elements(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.ply"
    path.write_text("ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(djpt.SceneError, match=rf"{kind}: a\.ply: (the file has no elements|a mesh needs the elements)"):
        djpt.load_dict({"type": kind, "filename": str(path)})


def untrusted(folder: Path, content: str) -> Any:
    """Load a scene of a stranger."""
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{content}</scene>')
    return djpt.load_file(path, trusted=False)


def bitmap(name: str) -> str:
    return (
        '<shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        f'<string name="filename" value="{name}"/></texture></bsdf></shape>'
    )


def forged_exr(path: Path, width: int, height: int) -> None:
    """A small image whose header claims another size."""
    djpt.write(path, np.zeros((4, 4, 3), np.float32))
    data = bytearray(path.read_bytes())
    for name in (b"dataWindow", b"displayWindow"):
        place = data.index(name + b"\0box2i\0") + len(name) + 7 + 4
        data[place : place + 16] = struct.pack("<4i", 0, 0, width - 1, height - 1)
    path.write_bytes(data)


def png(path: Path, width: int, height: int, depth: int, color: int) -> None:
    """A whole PNG of zeros."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[color]
    row = 1 + (width * depth * channels + 7) // 8
    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(row)) for _ in range(height)) + packer.flush()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    palette = chunk(b"PLTE", bytes(6)) if color == 3 else b""
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + palette + chunk(b"IDAT", packed) + chunk(b"IEND", b"")
    )


@pytest.mark.parametrize(("width", "height"), [(31623, 31623), (10**9, 1), (1, 10**9), (8192, 8192)])
def test_an_exr_that_claims_too_much_is_refused_by_its_header(tmp_path: Path, width: int, height: int) -> None:
    forged_exr(tmp_path / "a.exr", width, height)
    tracemalloc.start()
    with pytest.raises(djpt.SceneError, match=r"a\.exr.*by its header its \d+ bytes hold \d+ numbers"):
        untrusted(tmp_path, bitmap("a.exr"))
    with pytest.raises(djpt.SceneError, match="by its header"):
        untrusted(tmp_path, '<emitter type="envmap"><string name="filename" value="a.exr"/></emitter>')
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**24


@pytest.mark.parametrize(
    ("width", "height", "depth", "color"),
    [(8192, 8192, 8, 2), (20000, 20000, 1, 0), (20000, 20000, 1, 3), (10000, 10000, 16, 6)],
)
@pytest.mark.sparse(4)
def test_a_png_that_inflates_too_much_is_refused(
    tmp_path: Path, width: int, height: int, depth: int, color: int
) -> None:
    png(tmp_path / "a.png", width, height, depth, color)
    tracemalloc.start()
    with pytest.raises(djpt.SceneError, match=r"a\.png"):
        untrusted(tmp_path, bitmap("a.png"))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**24


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 31623 +X 31623\n" + bytes(1000)),
        ("a.pfm", b"PF\n31623 31623\n-1.0\n" + bytes(1000)),
        ("a.npy", None),
        ("a.ppm", b"P6\n31623 31623\n255\n" + bytes(1000)),
        ("a.bmp", b"BM" + struct.pack("<IIIIiiHHIIIIII", 1054, 0, 54, 40, 31623, 31623, 1, 24, 0, 0, 0, 0, 0, 0)),
        ("a.jpg", None),
    ],
)
def test_other_pictures_that_claim_too_much_are_refused(tmp_path: Path, name: str, data: bytes | None) -> None:
    path = tmp_path / name
    if name == "a.npy":
        np.save(path, np.zeros((4, 4, 3), np.float32))
        data = path.read_bytes().replace(b"(4, 4, 3), }        ", b"(31623, 31623, 3), }")
    if name == "a.jpg":
        djpt.write(path, np.zeros((16, 16, 3), np.float32))
        data = path.read_bytes().replace(struct.pack(">HH", 16, 16), struct.pack(">HH", 60000, 60000), 1)
    assert data is not None
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(djpt.SceneError, match=name):
        untrusted(tmp_path, bitmap(name))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**24


def test_large_uniform_pictures_of_ones_own_are_read(tmp_path: Path) -> None:
    """What may claim too much is only refused where the scene is a stranger's."""
    png(tmp_path / "a.png", 6000, 4000, 8, 0)
    with pytest.raises(djpt.SceneError, match="by its header"):
        untrusted(tmp_path, bitmap("a.png"))
    assert djpt.load_file(tmp_path / "scene.xml") is not None
    png(tmp_path / "a.png", 600, 400, 8, 2)
    assert untrusted(tmp_path, bitmap("a.png")) is not None


@pytest.mark.parametrize("length", [2000, 300_000_000])
@pytest.mark.sparse(2)
def test_the_name_of_a_serialized_mesh_is_bounded(tmp_path: Path, length: int) -> None:
    packer = zlib.compressobj(9)
    packed = packer.compress(struct.pack("<I", 0))
    packed += b"".join(packer.compress(b"x" * 100_000) for _ in range(max(1, length // 100_000))) + packer.flush()
    (tmp_path / "a.serialized").write_bytes(struct.pack("<HH", 0x041C, 4) + packed)
    start = time.monotonic()
    with pytest.raises(djpt.SceneError, match=r"a\.serialized: the name of the mesh has more than 1000 bytes"):
        untrusted(tmp_path, '<shape type="serialized"><string name="filename" value="a.serialized"/></shape>')
    assert time.monotonic() - start < 5
