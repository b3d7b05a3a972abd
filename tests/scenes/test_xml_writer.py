"""From dicts to scene files and back: the same scene, for djpt and for Mitsuba."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.mitsuba.xml import dict_to_xml, read_file, read_string
from djpt.scenes import SCENES
from tests.kit.axes import unit


def plain(value: Any) -> Any:
    """Something that can be compared: transforms and arrays as lists, greys as three numbers."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, T):
        return value.matrix.tolist()
    return np.array(value).tolist() if isinstance(value, (list, tuple, np.ndarray)) else value


@pytest.mark.parametrize("name", sorted({*SCENES} - {"pool"}))  # its water is a mesh in memory
def test_a_built_in_scene_survives(name: str) -> None:
    description = SCENES[name]()
    again = read_string(djpt.to_xml(description))
    assert plain(again) == plain(description)
    assert list(again) == list(description)
    assert plain(read_string(djpt.to_xml(again))) == plain(again)


def test_mitsuba_reads_what_is_written() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    description = djpt.cornell_box()
    written = dict(mi.traverse(mi.load_string(djpt.to_xml(description), optimize=False)))
    direct = dict(mi.traverse(mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False)))
    assert set(written) == set(direct)
    for name, value in direct.items():
        assert str(written[name]).replace("-0,", "0,") == str(value).replace("-0,", "0,"), name


def entries() -> dict[str, Any]:
    return {
        "b": True,
        "i": -3,
        "f": 0.1,
        "tiny": 1e-38,
        "s": "a < b & \"c\" 'd' $e \\$f \u00e9 \U0001f600 \n\t",
        "empty": "",
        "p": [0.1, 2.0, -3.5],
        "n": np.float32(0.1),
        "m": T().rotate(unit(1, 2, 3), 40).translate([1, 2, 3]).scale([1, 2, 3]),
        "identity": T(),
        "scaled": T().scale([1, -2, 3]),
        "moved": T().translate([0, 1 / 3, 0]),
        "both": T().translate([0.1, 0.2, 0.3]).scale(0.7),
        "list": np.diag([1.0, 2.0, 3.0, 1.0]).tolist(),
        "vector": djpt.Point3f(1, 2, 3),
        "grey": {"type": "rgb", "value": 0.25},
        "rgb": {"type": "rgb", "value": [0.1, 0.2, 0.3]},
        "spectrum": {"type": "spectrum", "value": [(400.0, 0.1), (700.0, 0.9)]},
        "uniform": {"type": "spectrum", "value": 0.5},
    }


def test_every_sort_of_value_survives_with_all_digits() -> None:
    found = read_string(djpt.to_xml({"type": "sphere", **entries()}))
    expected = plain(entries())
    expected["grey"]["value"] = [0.25] * 3
    expected["n"] = float(np.float32(0.1))
    expected["vector"] = [1.0, 2.0, 3.0]
    assert list(found) == ["type", *expected]
    for key, value in expected.items():
        assert plain(found[key]) == value, key


@settings(max_examples=50, deadline=None)
@given(
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8")),
    st.integers(-(2**63), 2**63),
)
def test_any_number_and_any_text(number: float, text: str, whole: int) -> None:
    description = {"type": "sphere", "f": number, "s": text, "i": whole}
    try:
        xml = djpt.to_xml(description)
    except djpt.SceneError as error:
        assert "an XML file can't hold the character" in str(error)
        return
    found = read_string(xml)
    assert math.copysign(1, found["f"]) == math.copysign(1, number)
    assert found == description


REFERENCES: dict[str, dict[str, Any]] = {
    "by key": {"m": {"type": "diffuse"}, "s": {"type": "sphere", "bsdf": {"type": "ref", "id": "m"}}},
    "by id": {"m": {"type": "diffuse", "id": "My.Id"}, "s": {"type": "sphere", "bsdf": {"type": "ref", "id": "My.Id"}}},
    "by key in spite of an id": {
        "m": {"type": "diffuse", "id": "other"},
        "s": {"type": "sphere", "bsdf": {"type": "ref", "id": "m"}},
    },
    "by path": {
        "t": {"type": "cube", "bsdf": {"type": "diffuse"}},
        "s": {"type": "sphere", "bsdf": {"type": "ref", "id": "t.bsdf"}},
        "t_bsdf": {"type": "diffuse"},
    },
    "by a chain": {
        "m": {"type": "diffuse"},
        "t": {"type": "cube", "bsdf": {"type": "ref", "id": "m"}},
        "s": {"type": "sphere", "bsdf": {"type": "ref", "id": "t.bsdf"}},
    },
    "a colour": {
        "m": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.1, 0.2, 0.3]}},
        "s": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "ref", "id": "m.reflectance"}}},
    },
}


@pytest.mark.parametrize("nodes", REFERENCES.values(), ids=list(REFERENCES))
def test_references_lead_to_the_same_nodes(nodes: dict[str, Any]) -> None:
    description = {"type": "scene", **nodes}
    direct, again = djpt.load_dict(description), djpt.load_string(djpt.to_xml(description))
    before, after = djpt.traverse(direct), djpt.traverse(again)
    assert [key for key, _ in before.items()] == [key for key, _ in after.items()]
    for key, value in before.items():
        assert str(value) == str(after[key]), key


def test_files_are_named_relative_to_the_new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out" / "models").mkdir(parents=True)
    (tmp_path / "out" / "models" / "a.ply").touch()
    (tmp_path / "b.ply").touch()
    monkeypatch.chdir(tmp_path)
    mesh = {"type": "ply", "filename": "out/models/a.ply"}
    djpt.write_dict("out/scene.xml", {"type": "scene", "a": mesh, "b": {"type": "ply", "filename": "b.ply"}})
    text = (tmp_path / "out" / "scene.xml").read_text()
    assert 'value="models/a.ply"' in text
    assert f'value="{tmp_path}/b.ply"' in text
    found = read_file("out/scene.xml")
    assert found["a"]["filename"] == str(tmp_path / "out" / "models" / "a.ply")
    assert mesh["filename"] == "out/models/a.ply"


def test_dict_to_xml_has_mitsubas_arguments(tmp_path: Path) -> None:
    dict_to_xml(djpt.cornell_box(), tmp_path / "box.xml")
    assert plain(read_file(tmp_path / "box.xml")) == plain(djpt.cornell_box())


UNWRITABLE = {
    "a plugin": ({"type": "sphere", "bsdf": None}, "sphere.bsdf: is a Diffuse object; only descriptions"),
    "a function": ({"type": "sphere", "f": len}, "sphere.f: a scene file can't hold this; it must be numbers, found"),
    "None": ({"type": "sphere", "f": None}, "sphere.f: a scene file can't hold this; it must be numbers, found None"),
    "pixels": (
        {"type": "sphere", "f": np.zeros((4, 3, 2))},
        r"sphere.f: a scene file can't hold this array of shape (4, 3, 2)",
    ),
    "infinite": ({"type": "sphere", "f": math.inf}, "sphere.f: must be finite in single precision, found float inf"),
    "control": (
        {"type": "sphere", "f": "a\0b"},
        r"sphere.f: an XML file can't hold the character '\x00' of str 'a\x00b'",
    ),
    "unknown": ({"type": "scene", "a": {"type": "spher"}}, "scene.a: unknown plugin 'spher'; did you mean 'sphere'?"),
    "circle": (
        {"type": "scene", "a": {"type": "ref", "id": "b"}, "b": {"type": "ref", "id": "a"}},
        "scene.a: references form a cycle",
    ),
    "nowhere": ({"type": "scene", "a": {"type": "ref", "id": "b"}}, "scene.a: nothing has the id 'b'"),
    "not a dict": ([1], "load_dict: a scene description is a dict, found list [1]"),
}


@pytest.mark.parametrize(("description", "message"), UNWRITABLE.values(), ids=list(UNWRITABLE))
def test_what_a_file_cant_hold(description: Any, message: str, tmp_path: Path) -> None:
    if isinstance(description, dict) and "bsdf" in description:
        description["bsdf"] = djpt.load_dict({"type": "diffuse"})
    target = tmp_path / "a.xml"
    target.write_text("old")
    with pytest.raises(djpt.SceneError) as caught:
        djpt.write_dict(target, description)
    assert str(caught.value).startswith(message)
    assert target.read_text() == "old"


def test_a_place_that_cant_be_written(tmp_path: Path) -> None:
    with pytest.raises(djpt.FileError, match=r"can't write '.*none/a\.xml': there is no folder"):
        djpt.write_dict(tmp_path / "none" / "a.xml", {"type": "sphere"})
    (tmp_path / "folder.xml").mkdir()
    with pytest.raises(djpt.FileError, match="can't write"):
        djpt.write_dict(tmp_path / "folder.xml", {"type": "sphere"})
    assert [path.name for path in tmp_path.iterdir()] == ["folder.xml"]
