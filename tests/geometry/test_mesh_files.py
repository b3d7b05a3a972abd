"""Mesh files: the same vertices, faces and attributes as Mitsuba reads, and what is said of broken ones."""

from __future__ import annotations

import copy
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import DjptError, FileError, SceneError
from djpt.jit.llvm.host import HostFunctions
from djpt.shapes.mesh import MeshFile
from djpt.shapes.meshes import normals, obj
from djpt.shapes.meshes.data import MeshData
from djpt.shapes.meshes.normal_functions import PARAMETERS, add_normal_functions
from djpt.shapes.meshes.obj import read_compiled, read_obj, read_plainly
from djpt.shapes.meshes.ply import read_ply
from djpt.shapes.meshes.serialized import read_serialized
from tests.kit.axes import unit
from tests.kit.meshes import bumpy_sheet, properties, write_binary_ply, write_obj, write_ply, write_serialized

CORNERS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
TEXCOORDS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0.5 0.25\n"
NORMALS = "vn 0 0 2\nvn 0 1 1\n"


@pytest.fixture(scope="module")
def mi() -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def assert_same(mi: Any, kind: str, path: Path, **keys: Any) -> djpt.Mesh:
    """Both renderers read the same parameters from a file."""
    theirs_keys = {k: mi.ScalarTransform4f(v.matrix) if isinstance(v, T) else v for k, v in keys.items()}
    theirs = mi.traverse(mi.load_dict({"type": kind, "filename": str(path), **theirs_keys}))
    mesh = djpt.load_dict({"type": kind, "filename": str(path), **keys})
    ours = djpt.traverse(mesh)
    names = [key for key, _ in theirs.items()]
    # Mitsuba's attributes come in the order of a hash table.
    assert list(ours.keys())[:5] == names[:5]
    assert sorted(ours.keys()) == sorted(names)
    for key in ours:
        # A grey is three numbers here, and one there.
        mine, other = np.broadcast_arrays(*(np.ravel(np.array(params[key])) for params in (ours, theirs)))
        np.testing.assert_allclose(mine, other, atol=1e-6, err_msg=key)
    return mesh


MOVED = T().translate([1, 2, 3]).rotate(unit(1, 2, 0), 50).scale([1, 2, 0.5])
OPTIONS: list[dict[str, Any]] = [{}, {"face_normals": True}, {"flip_tex_coords": True}, {"to_world": MOVED}]


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply(mi: Any, tmp_path: Path, order: str, options: dict[str, Any]) -> None:
    assert_same(mi, "ply", write_binary_ply(tmp_path / "a.ply", bumpy_sheet(), order), **options)


def test_missing_normals_are_computed(mi: Any, tmp_path: Path) -> None:
    mesh = assert_same(mi, "ply", write_binary_ply(tmp_path / "a.ply", bumpy_sheet(), normals=False))
    assert mesh.normals is not None


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_ply_go_by_three_names(mi: Any, tmp_path: Path, names: tuple[str, str]) -> None:
    rows = "0 0 0 .1 .2\n1 0 0 .3 .4\n0 1 0 .5 .6\n"
    mesh = assert_same(mi, "ply", write_ply(tmp_path / "a.ply", rows, "3 0 1 2", properties(*names)))
    assert mesh.texcoords is not None


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("red green blue", {"vertex_color": 3}),
        ("r g b a", {"vertex_color": 4}),
        ("heat_0", {"vertex_heat": 1}),
        ("flow_x flow_y flow_z r g b", {"vertex_color": 3, "vertex_flow": 3}),
        ("my_flow_1 my_flow_2 my_flow_3 heat_0", {"vertex_my_flow": 3, "vertex_heat": 1}),
    ],
)
def test_vertex_attributes(mi: Any, tmp_path: Path, names: str, found: dict[str, int]) -> None:
    columns = names.split()
    rows = [
        corner + "".join(f" {k + 10 * i}" for k in range(len(columns)))
        for i, corner in enumerate(CORNERS.split("\n")[:3])
    ]
    path = write_ply(tmp_path / "a.ply", "\n".join(rows), "3 0 1 2", properties(*columns))
    mesh = assert_same(mi, "ply", path)
    assert {name: values.shape[1] for name, (values, kind) in mesh.attributes.items() if kind == "vertex"} == found


def test_face_attributes_follow_their_triangles(tmp_path: Path) -> None:
    faces = "4 0 1 2 3 0.5\n3 0 0 1 9\n3 0 1 3 0.25\n"
    path = write_ply(tmp_path / "a.ply", CORNERS, faces, more_face=properties("heat_0"))
    with pytest.warns(UserWarning, match="dropped triangles: 1 without area; the first is face 2"):
        mesh = djpt.load_dict({"type": "ply", "filename": str(path)})
    assert mesh.indices.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 3]]
    assert mesh.attributes["face_heat"][0].ravel().tolist() == [0.5, 0.5, 0.25]


def test_other_properties_are_ignored_with_one_warning(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "a.ply", "0 0 0 1 2\n1 0 0 1 2\n0 1 0 1 2", "3 0 1 2", properties("quality", "pair_0"))
    with pytest.warns(UserWarning, match="ignored properties of 'vertex': quality$") as caught:
        mesh = djpt.load_dict({"type": "ply", "filename": str(path)})
    assert len(caught) == 1
    assert list(mesh.attributes) == ["vertex_pair"]


@pytest.mark.filterwarnings("ignore:x.ply. ignored properties of 'face'. flags")
def test_ply_with_polygons_and_other_elements() -> None:
    header = "format {}\nelement camera 1\nproperty double f\nelement vertex 4\nproperty double x\nproperty double y\n"
    header += "property double z\nelement face 2\nproperty uchar flags\nproperty list uchar ushort vertex_index\n"
    header += "element edge 1\nproperty list uint int pair\nend_header\n"
    text = "ply\n" + header.format("ascii 1.0") + "1.5\n" + CORNERS + "7 3 0 1 2\n7 4 0 1 2 3\n2 0 1\n"
    corners = np.array(CORNERS.split(), "<f8").tobytes()
    body = b"".join(
        [np.float64(1.5).tobytes(), corners, b"\7\3", np.array([0, 1, 2], "<u2").tobytes(), b"\7\4",
         np.array([0, 1, 2, 3], "<u2").tobytes(), np.array([2, 0, 1], "<u4").tobytes()]
    )  # fmt: skip
    binary = b"ply\n" + header.format("binary_little_endian 1.0").encode() + body
    for data in (text.encode(), binary):
        mesh = read_ply(data, "x.ply")
        assert mesh.indices.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3]]
        np.testing.assert_array_equal(mesh.positions, np.array(CORNERS.split(), float).reshape(4, 3))


def test_a_written_mesh_is_read_back_by_both(mi: Any, tmp_path: Path) -> None:
    sheet = bumpy_sheet()
    attributes = {
        "vertex_color": sheet["normals"],
        "face_flow": np.ones((32, 3)),
        "vertex_heat": np.arange(25.0)[:, None],
    }
    mesh = djpt.Mesh("m", sheet["positions"], sheet["faces"], sheet["normals"], sheet["texcoords"], None, attributes)
    mesh.write_ply(tmp_path / "a.ply")
    again = assert_same(mi, "ply", tmp_path / "a.ply")
    for key, value in djpt.traverse(mesh).items():
        np.testing.assert_allclose(np.array(djpt.traverse(again)[key]), np.array(value), atol=1e-6, err_msg=key)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]
    with pytest.raises(FileError, match="can't write"):
        mesh.write_ply(tmp_path / "nowhere" / "a.ply")


# ---------------------------------------------------------------- obj


@pytest.mark.parametrize("options", OPTIONS)
def test_obj(mi: Any, tmp_path: Path, options: dict[str, Any]) -> None:
    assert_same(mi, "obj", write_obj(tmp_path / "a.obj", bumpy_sheet()), **options)


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3 4",
        "f 3 1 2\nf 4 3 2",
        "f 1/1 2/2 3/3\nf 1/4 3/3 4/1",
        "f 1/1 2/1 3/1\nf 1/1 3/1 4/2\nf 1/2 3/1 4/2",
        "f 1//1 2//2 3//1",
        "f 1/1/1 2/1/1 3/1/2\nf 1/1/2 3/1/2 4/2/2",
        "# comment\n  f 1 2 3\no name\ng x\nusemtl y\ns off\nf\t1 3 4",
        "f 1 2\nf 1 2 3",
    ],
)
def test_vertices_of_obj_are_merged_and_numbered_as_by_mitsuba(mi: Any, tmp_path: Path, faces: str) -> None:
    path = tmp_path / "a.obj"
    # Mitsuba leaves arrays unset for what a file has but no face uses.
    uses_normals = "//" in faces or faces.count("/") > 9
    texcoords = TEXCOORDS if "/" in faces.replace("//", "") else ""
    path.write_text(OBJ + texcoords + (NORMALS if uses_normals else "") + faces + "\n")
    assert_same(mi, "obj", path)


def test_obj_beyond_what_mitsuba_reads() -> None:
    def faces(text: str) -> list[list[int]]:
        return read_obj(text.encode(), "x.obj").indices.tolist()

    assert faces(OBJ + "f -4 -3 -2\nv 5 5 5\nf -1 1 -2") == [[0, 1, 2], [3, 0, 4]]
    assert faces(OBJ.replace("\n", "\r\n") + "f 1 2 \\\r\n3 4") == [[0, 1, 2], [0, 2, 3]]
    assert faces("f 1 2 3 # first\n" + OBJ) == [[0, 1, 2]]
    mesh = read_obj((OBJ + TEXCOORDS + NORMALS + "f 1 2/2 3/3/1 4//2").encode(), "x.obj")
    assert mesh.texcoords is not None
    assert mesh.texcoords.tolist() == [[0, 0], [1, 0], [1, 1], [0, 0]]
    assert mesh.normals is not None
    assert mesh.normals.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 2], [0, 1, 1]]


def test_obj_with_lines_in_any_order() -> None:
    """Numbers count the lines of a kind, wherever these stand, and errors name the line."""
    mixed = (
        "# f 9 9 9\nv 0 0 0\nvt 0 0\nv 1 0 0 # v 7 7 7\n\nvn 0 0 1\nf 1/1/1 2/2/1 3/1/1\n  vt 1 \\\n 0\n"
        "vp 1 2 3\nv 0 1 0\nf 3 2 4\ng f 1 2 3\n\tv 1 1 0"
    )
    kinds = ("v ", "vt ", "vn ", "f ")
    lines = [line.strip().split(" #")[0] for line in mixed.replace("\\\n", "").split("\n")]
    sorted_ = "\n".join(line for kind in kinds for line in lines if line.startswith(kind))
    found, expected = (read_obj(text.encode(), "x.obj") for text in (mixed, sorted_))
    assert found.indices.tolist() == [[0, 1, 2], [3, 4, 5]]
    for name in ("positions", "indices", "normals", "texcoords"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    with pytest.raises(SceneError, match=r"x.obj, line 13: 'v' must be followed by 3 numbers, found fewer words"):
        read_obj(mixed.replace("g f 1 2 3", "v 1 2").encode(), "x.obj")


# ---------------------------------------------------------------- obj by compiled functions

KNOWN = [
    OBJ + "f 1 2 3 4",
    OBJ + TEXCOORDS + NORMALS + "f 1/1/1 2/2/1 3/3/2\nf -4/-4/-2 -2/-2/-1 -1/-1/-1 # the other half\n\n",
    OBJ + NORMALS + "o x\r\nf 1//1 2//2 3//1\r\nf\t1//2 2//2 4//1 ",
    "f 1 2 3\nv 1e2 -2.5E-3 +.5\nv 5. 0.000000000000000000000000 -0 9 9\nv 1 2 3.25e1\n",
    "".join(f"v {i} {i / 7:.17f} {-i / 3:.9g}e-30\n" for i in range(99))
    + "".join(f"f {i} 1 {i + 1}\n" for i in range(1, 99)),
    OBJ + "".join(f"vt {i} 0\n" for i in range(50)) + "".join(f"f 1/{i} 2/{i} 3/1\n" for i in range(1, 50)),
    "v 3.4028236e29 4e22 1e-44\nv 1.17549421e-36 33554433 33554435\nv 16777217 0.1 0.3\nf 1 2 3",
    OBJ + "f\nf 1\nf 1 2\nf 3 2 1",
    OBJ + "f 1 2 \\\n3",
]
UNKNOWN = [
    OBJ + "f 1 2 9",
    OBJ + f"f 1 2 {10**20}",
    OBJ + "f 0 1 2",
    OBJ + "f -5 1 2",
    OBJ + "f 1/ 2/ 3/",
    OBJ + "f 1.5 2 3",
    OBJ + "f 1/1 2 3",
    OBJ + "v 1 2",
    OBJ + "v 1 2 nan",
    OBJ + "v 1 2 3x",
    OBJ + "v 1e500 2 3",
    OBJ + "v 0.12345678901234567890123 2 3",
    OBJ + "v\x011 2 3",
]


@pytest.fixture
def from_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small files are read by compiled functions, too, from the first on."""
    monkeypatch.setattr(obj.FUNCTIONS, "few", 0)


def assert_equal(found: MeshData, expected: MeshData) -> None:
    """Two meshes have the same bits."""
    for name in ("positions", "indices", "normals", "texcoords"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            assert (ours.shape, ours.dtype, ours.tobytes()) == (theirs.shape, theirs.dtype, theirs.tobytes()), name


@pytest.mark.usefixtures("from_the_first")
@pytest.mark.parametrize("text", KNOWN)
def test_compiled_functions_read_the_same_from_obj_files(text: str) -> None:
    found = read_compiled(text.encode())
    assert found is not None
    assert_equal(found, read_plainly(text.encode(), "x.obj"))


@pytest.mark.usefixtures("from_the_first")
@pytest.mark.parametrize("text", UNKNOWN)
def test_compiled_functions_leave_unusual_obj_files_to_the_plain_reader(text: str) -> None:
    assert read_compiled(text.encode()) is None


WORDS = (
    "v vt vn f vp # 1 2 3 -1 -2 0 1/1 2/2 3/1 1//1 2//2 2/1/1 -1/-1/-1 1/ /1 1/2/ 0.5 -.25 1e1 2. x 0.1234567|\n|\n|\n"
    "|\nv 1 2 3\n|\nvt 1 2\n|\nvn 0 0 1\n|\nf 1 2 1\n|\t|\\\n|\r\n|\x00"
)
ALPHABET = [word for part in WORDS.split("|") for word in (part.split(" ") if part.startswith("v vt") else [part])]


@pytest.mark.usefixtures("from_the_first")
@settings(max_examples=400, deadline=None)
@given(words=st.lists(st.sampled_from(ALPHABET), max_size=25))
def test_no_obj_file_whatsoever_is_read_in_two_ways(words: list[str]) -> None:
    text = " ".join(words).encode()
    found = read_compiled(text)
    if found is not None:
        assert_equal(found, read_plainly(text, "x.obj"))


def test_small_obj_files_compile_nothing_unless_they_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    few = obj.FUNCTIONS.few
    monkeypatch.setattr(obj, "FUNCTIONS", copy.copy(obj.FUNCTIONS))
    monkeypatch.setattr(obj.FUNCTIONS, "_small_jobs", 0)
    found = [read_compiled(KNOWN[0].encode()) for _ in range(few + 2)]
    assert found[:few] == [None] * few
    assert None not in found[few:]


@pytest.mark.parametrize("count", [1, 7, 9000])
def test_compiled_functions_compute_the_same_normals(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    rng = np.random.default_rng(count)
    positions = rng.normal(size=(count // 2 + 3, 3)).astype(np.float32)
    positions[0] = [1e-30, 1e30, 0]
    # Some triangles have no area, and some vertices no triangle.
    indices = rng.integers(0, len(positions) - 1, (count, 3)).astype(np.uint32)
    results = []
    for few in (0, 1 << 60):
        monkeypatch.setattr(normals, "FUNCTIONS", HostFunctions(add_normal_functions, PARAMETERS, 1 << 60, few))
        results.append([normals.weighted_normals(positions, indices), normals.face_areas(positions, indices)])
    for compiled, plain in zip(*results, strict=True):
        assert (compiled.dtype, compiled.shape, compiled.tobytes()) == (plain.dtype, plain.shape, plain.tobytes())


def test_a_file_that_several_shapes_name_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, sheet = tmp_path / "a.serialized", bumpy_sheet()
    write_serialized(path, [sheet, {**sheet, "positions": sheet["positions"] * 2}])
    reads: list[str] = []
    load = MeshFile.load

    def noted(props: Any, path: Path) -> bytes:
        reads.append(path.name)
        return load(props, path)

    monkeypatch.setattr(MeshFile, "load", staticmethod(noted))
    one = {"type": "serialized", "filename": str(path), "flip_tex_coords": True}
    scene = djpt.load_dict({"type": "scene", "a": one, "b": {**one, "to_world": MOVED}, "c": {**one, "shape_index": 1}})
    assert reads == ["a.serialized"] * 2
    a, b, c = scene.shapes()
    np.testing.assert_allclose(b.positions, MOVED @ a.positions, atol=1e-5)
    np.testing.assert_array_equal(b.texcoords, a.texcoords)
    np.testing.assert_array_equal(c.positions, 2 * a.positions)
    before = a.positions.copy()
    parameters = djpt.traverse(scene)
    parameters["b.vertex_positions"] = parameters["b.vertex_positions"] + 1
    parameters.update()
    np.testing.assert_array_equal(a.positions, before)
    del reads[:]
    assert djpt.load_dict(one).positions.tolist() == before.tolist()
    assert reads == ["a.serialized"]


# ---------------------------------------------------------------- serialized


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("double", [False, True])
def test_serialized(mi: Any, tmp_path: Path, version: int, double: bool) -> None:
    sheet, small = bumpy_sheet(), bumpy_sheet(3, seed=1)
    plain = {key: small[key] for key in ("positions", "faces")}
    meshes = [plain, sheet | {"colors": sheet["normals"]}, small]
    path = write_serialized(tmp_path / "a.serialized", meshes, version, double)
    assert_same(mi, "serialized", path)
    for index in range(3):
        mesh = assert_same(mi, "serialized", path, shape_index=index, to_world=MOVED)
        assert len(mesh.indices) == len(meshes[index]["faces"])
    assert_same(mi, "serialized", path, shape_index=1, face_normals=True)


# ---------------------------------------------------------------- errors


def ply_error(tmp_path: Path, **replacements: str) -> str:
    path = write_ply(tmp_path / "bad.ply", CORNERS, "3 0 1 2\n3 0 2 3")
    text = path.read_text()
    for old, new in replacements.items():
        old = old.replace("__", "\n").replace("_", " ")
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    with pytest.raises(SceneError) as error:
        djpt.load_dict({"type": "scene", "thing": {"type": "ply", "filename": str(path)}})
    return str(error.value)


@pytest.mark.parametrize(
    ("replacements", "message"),
    [
        ({"ply__format": "obj\nformat"}, "scene.thing: bad.ply: not a PLY file: it doesn't begin with the line 'ply'"),
        ({"ascii": "asci"}, "bad.ply, line 2: unknown format 'asci'; did you mean 'ascii'?"),
        ({"float_y": "flaot y"}, "bad.ply, line 6: unknown type 'flaot'; did you mean 'float'?"),
        ({"float_y": "float x"}, "bad.ply: the element 'vertex' declares a property twice"),
        ({"float_y": "float why"}, "bad.ply: vertices need the properties x, y, z; found: x, why, z"),
        ({"element_vertex": "element verteks"}, "needs the elements 'vertex' and 'face', found: verteks, face"),
        ({"element_face_2": "elements"}, "bad.ply, line 8: can't understand this line of 'elements'"),
        ({"end_header": ""}, "the file ends in its header: no line 'end_header'"),
        ({"1_1_0": "1 1"}, "bad.ply, line 13: row 2 of the element 'vertex' should have 3 numbers, found 2"),
        ({"1_1_0": "1 one 0"}, "bad.ply, line 13: 'one' isn't a number"),
        ({"__3_0_2_3": ""}, "bad.ply, line 16: the file is cut short, in row 1 of 2 of the element 'face'"),
        ({"3_0_2_3": "3 0 2 4"}, "bad.ply: face 1 refers to vertex 4; there are 4, counted from 0"),
        ({"3_0_2_3": "3 0 2 -1"}, "bad.ply: face 1 refers to vertex -1; there are 4, counted from 0"),
        ({"3_0_1_2": "3 0 1"}, "bad.ply, line 16: row 0 of the element 'face' should have 4 numbers, found 3"),
        ({"vertex_4": "vertex 9999999999999"}, "row 4 of the element 'vertex' should have 3 numbers, found 4"),
        ({"face_2": "face 0"}, "bad.ply: the mesh is empty: 4 vertices, no triangle"),
    ],
)
def test_a_broken_ply_is_explained(tmp_path: Path, replacements: dict[str, str], message: str) -> None:
    # `end_header` itself has an underscore.
    if "end_header" in replacements:
        path = write_ply(tmp_path / "bad.ply", CORNERS, "3 0 1 2")
        with pytest.raises(SceneError, match=message):
            read_ply(path.read_bytes().replace(b"end_header\n", b"")[:150], "bad.ply")
        return
    assert message in ply_error(tmp_path, **replacements)


def test_a_binary_ply_that_is_cut_short_says_where(tmp_path: Path) -> None:
    data = write_binary_ply(tmp_path / "a.ply", bumpy_sheet()).read_bytes()
    start = data.index(b"end_header\n") + 11
    with pytest.raises(
        SceneError, match=r"a.ply, byte 1\d\d\d: the file is cut short, in row 24 of 25 of the element 've"
    ):
        read_ply(data[: start + 25 * 32 - 1], "a.ply")
    with pytest.raises(SceneError, match="in row 31 of 32 of the element 'face'"):
        read_ply(data[:-1], "a.ply")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OBJ + TEXCOORDS + "f 1/1 2/9 3/3", "a.obj, line 9: a face refers to the texture coordinate 9; there are 4"),
        (OBJ + "f 1/1 2/1 3/1", "a.obj, line 5: a face refers to the texture coordinate 1; there is none"),
        (OBJ + "f 1//1 2//1 3//1", "a.obj, line 5: a face refers to the normal 1; there is none"),
        (OBJ + "\n\nf 1 2 3\nf 1 2 9", "a.obj, line 8: a face refers to the vertex 9; there are 4, counted from 1"),
        (OBJ + "f 0 1 2", "a.obj, line 5: a face refers to the vertex 0; there are 4"),
        ("f -1 -2 -3\n" + OBJ, "a.obj, line 1: a face refers to the vertex before the first"),
        (OBJ + "f 1 2 x", "a.obj, line 5: can't understand the corner 'x' of a face; possible: v, v/vt"),
        (OBJ + "f 1 2 " + "3" * 5000, "a.obj, line 5: can't understand the corner '3333"),
        (OBJ + "f 1/x 2/ 3/", "a.obj, line 5: can't understand the corner '1/x'"),
        (OBJ + "f 1/1/1/ 2 3", "a.obj, line 5: can't understand the corner '1/1/1/'"),
        (OBJ + "f 1.5 2 3", "a.obj, line 5: can't understand the corner '1.5'"),
        ("v 0 0\n" + OBJ, "a.obj, line 1: 'v' must be followed by 3 numbers, found fewer words"),
        (OBJ + "vt nothing", "a.obj, line 5: 'vt' must be followed by 2 numbers, found fewer words"),
        (OBJ, "a.obj: the mesh is empty: 0 vertices, no triangle"),
        ("", "a.obj: the mesh is empty"),
    ],
)
def test_a_broken_obj_is_explained_by_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.obj"
    path.write_text(text)
    with pytest.raises(SceneError) as error:
        djpt.load_dict({"type": "scene", "thing": {"type": "obj", "filename": str(path)}})
    assert f"scene.thing: {message}" in str(error.value)


def test_a_broken_serialized_file_is_explained(tmp_path: Path) -> None:
    data = write_serialized(tmp_path / "a.serialized", [bumpy_sheet()] * 2).read_bytes()
    for broken, index, message in (
        (data, 2, "'shape_index' 2 is out of range: the file has 2 meshes"),
        (b"no mesh!", 0, "not a 'serialized' mesh: it begins with 0x6f6e, not 0x041c"),
        (b"\x1c\x04\x09\x00", 0, "byte 2: unknown version 9; possible: 3, 4"),
        (b"", 0, "cut short"),
        (data[:200], 0, "the file is cut short within vertex positions"),
        (data[:40] + b"\0" * 60 + data[100:], 0, "damaged within"),
        (data[:-12] + b"\xff" * 8 + data[-4:], 1, "the list of meshes at its end is damaged: mesh 1 at byte"),
        (data[:-4] + b"\xff" * 4, 1, "it should have 4294967295 entries"),
    ):
        with pytest.raises(SceneError, match=message):
            read_serialized(broken, "a.serialized", index)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_files_never_do_more_than_raise_an_error(tmp_path_factory: Any, data: Any) -> None:
    folder = tmp_path_factory.getbasetemp()
    files = {
        read_ply: data.draw(st.sampled_from(["ascii", "binary"])),
        read_obj: "obj",
        read_serialized: "serialized",
    }
    reader = data.draw(st.sampled_from(sorted(files, key=lambda f: f.__name__)))
    sheet = bumpy_sheet(3)
    if files[reader] == "ascii":
        rows = "\n".join(" ".join(map(str, p)) for p in sheet["positions"])
        path = write_ply(folder / "f", rows, "\n".join("3 " + " ".join(map(str, f)) for f in sheet["faces"]))
    elif files[reader] == "binary":
        path = write_binary_ply(folder / "f", sheet)
    else:
        path = (write_obj if reader is read_obj else lambda p, m: write_serialized(p, [m]))(folder / "f", sheet)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.sampled_from([0, 10, 32, 45, 47, 48, 57, 128, 255]))
    cut = data.draw(st.integers(0, len(content)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            mesh = reader(bytes(content[:cut]), "f")
            djpt.Mesh("m", mesh.positions, mesh.indices, mesh.normals, mesh.texcoords)
        except DjptError:
            pass


def test_a_missing_file_is_named_with_the_places_searched(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"scene.thing: 'filename': 'nowhere.ply' doesn't exist; searched: "):
        djpt.load_dict({"type": "scene", "thing": {"type": "ply", "filename": "nowhere.ply"}})
    with pytest.raises(SceneError, match="can't read"):
        djpt.load_dict({"type": "ply", "filename": str(tmp_path)})


# ---------------------------------------------------------------- degenerate meshes


def test_triangles_that_cannot_be_hit_are_dropped_with_one_warning() -> None:
    nan = float("nan")
    positions = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [nan, 0, 0], [0, 0, 1e-20], [0, 1e-20, 0]]
    faces = [[0, 1, 3], [0, 1, 2], [0, 0, 1], [4, 1, 2], [0, 5, 6], [2, 1, 3]]
    with pytest.warns(UserWarning) as caught:
        mesh = djpt.Mesh("m", positions, faces, attributes={"face_id": np.arange(6.0)[:, None]})
    expected = "m: dropped triangles: 3 without area, 1 with a vertex that isn't finite; the first is face 0"
    assert [str(w.message) for w in caught] == [expected]
    assert mesh.indices.tolist() == [[0, 1, 2], [2, 1, 3]]
    assert mesh.attributes["face_id"][0].ravel().tolist() == [1, 5]
    assert np.isfinite(mesh.positions).all()
    assert mesh.interval(np.array([1.0, 0, 0])) == (0, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0, 0, 0]], [0, 0]), r"m: 'faces' must have the shape \(F, 3\), found \(2,\)"),
        (([[0, 0, 0]], np.zeros((0, 3))), "m: the mesh is empty: 1 vertices, no triangle"),
        (([[0, 0, 0]], [[0, 0, 0]]), "m: none of the 1 triangles can be rendered: 1 without area"),
        (([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]]), "m: face 0 refers to vertex 3; there are 3"),
        (([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, -1]]), "m: 'faces' must be whole numbers from 0 on"),
        (([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]), r"'vertex_positions' must have the shape \(N, 3\), found \(3, 2\)"),
        (("abc", [[0, 1, 2]]), "'vertex_positions' must be an array of numbers, found str 'abc'"),
        ((np.eye(3), [[0, 1, 2]], np.eye(2)), r"'vertex_normals' must have the shape \(3, 3\), found \(2, 2\)"),
        ((np.eye(3), [[0, 1, 2]], None, np.full((3, 2), np.inf)), "m: vertex_texcoords of vertex 0 isn't finite"),
        ((np.eye(3), [[0, 1, 2]], None, None, {"flip": 1}), "m: unknown key 'flip' of"),
        ((np.eye(3), [[0, 1, 2]], None, None, {"to_world": T().scale(0).matrix}), "m: 'to_world' must be invertible"),
        ((np.eye(3), [[0, 1, 2]], None, None, None, {"heat": [1]}), "'heat' must begin with 'vertex_' or 'face_'"),
        ((np.eye(3), [[0, 1, 2]], None, None, None, {"vertex_normals": np.eye(3)}), "can't be the name of an attri"),
    ],
)
def test_a_mesh_that_makes_no_sense_is_refused(arguments: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.Mesh("m", *arguments)


@pytest.mark.slow
def test_large_files_load_fast(tmp_path: Path) -> None:
    # Generous limits: machines differ. Measured on two cores: 0.3 s and 0.6 s.
    write_binary_ply(tmp_path / "big.ply", bumpy_sheet(708))
    write_obj(tmp_path / "big.obj", bumpy_sheet(225))
    for kind, limit in (("ply", 2.0), ("obj", 3.0)):
        start = time.process_time()
        djpt.load_dict({"type": kind, "filename": str(tmp_path / f"big.{kind}")})
        assert time.process_time() - start < limit
