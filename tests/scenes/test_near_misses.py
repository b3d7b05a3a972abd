"""The suggestions of messages: only what would be accepted, the nearest first, at most ten."""

import string
import time
from pathlib import Path
from typing import Any

import pytest

import djpt
from djpt.errors import FileError, SceneError, near_miss, nearest
from djpt.scenes.overrides import described

MANY = [letter * 3 for letter in string.ascii_lowercase]


def test_the_nearest_names_come_first() -> None:
    assert near_miss("spher", ["cube", "shapegroup", "sphere"]) == (
        "; did you mean 'sphere'? (possible: sphere, cube, shapegroup)"
    )
    assert near_miss("x", ["b", "a"]) == "; possible: a, b"
    assert near_miss("x", []) == ""
    assert near_miss("valu", ["value"], label="found") == "; did you mean 'value'? (found: value)"


def test_at_most_ten_names_are_listed() -> None:
    assert near_miss("?", MANY) == "; possible: aaa, bbb, ccc, ddd, eee, fff, ggg, hhh, iii, jjj and 16 more"
    assert near_miss("qqqq", MANY) == (
        "; did you mean 'qqq'? (possible: qqq, aaa, bbb, ccc, ddd, eee, fff, ggg, hhh, iii and 16 more)"
    )
    assert near_miss("name_x", [f"name_{i}" for i in range(30)]).count("name_") == 11


def test_a_name_alone() -> None:
    assert nearest("Rendr", ["render", "read"]) == "render"
    assert nearest("q", ["render", "read"]) is None


def test_many_names_take_no_time() -> None:
    names = [f"{'a' * 60}{i}" for i in range(20_000)]
    begin = time.process_time()
    near_miss("a" * 64, names)
    assert time.process_time() - begin < 2


SPHERE, CUBE, PAINT = {"type": "sphere"}, {"type": "cube"}, {"type": "diffuse"}
CAMERA = {"type": "perspective"}
FILM = {"type": "hdrfilm", "f": {"type": "x"}}


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        # Where a plugin of one kind fits, no other is listed.
        ({"integrator": {"type": "pth"}}, "unknown integrator 'pth'; did you mean 'path'"),
        ({"sensor": {**CAMERA, "film": {"type": "hdr"}}}, r"unknown film 'hdr'.*possible: hdrfilm\)$"),
        ({"sensor": {**CAMERA, "film": FILM}}, "unknown rfilter 'x'; possible: box, catmullrom"),
        # A reference can't refer to what is around it, nor to other kinds.
        (
            {"ball": {**SPHERE, "bsdf": {"type": "ref", "id": "bal"}}, "p": PAINT},
            "nothing has the id 'bal'; possible: p$",
        ),
        ({"f": {"type": "hdrfilm"}, "p": PAINT, "b": {**CUBE, "x": {"type": "ref", "id": "why"}}}, "possible: p$"),
        # What is given already isn't suggested again.
        (
            {"a": {"type": "disk", "flip_normals": True, "flip_normal": True}},
            "unknown key 'flip_normal' of .*possible: (?!f)",
        ),
    ],
)
def test_what_is_listed_would_be_accepted(scene: dict[str, Any], expected: str) -> None:
    with pytest.raises(SceneError, match=expected):
        djpt.load_dict({"type": "scene", **scene})


def test_parameters() -> None:
    params = djpt.traverse(djpt.load_dict(djpt.cornell_box()))
    with pytest.raises(djpt.ParameterError, match=r"; did you mean 'red.reflectance.value'\?") as caught:
        params["red.reflectance"]
    assert str(caught.value).count(",") < 10


def test_scene_files(tmp_path: Path) -> None:
    (tmp_path / "kitchen.xml").write_text("<scene version='3.0.0'/>")
    with pytest.raises(FileError, match=r"there is no such file; did you mean '.*kitchen\.xml'\?$"):
        described(str(tmp_path / "kichen.xml"))
    with pytest.raises(FileError, match=r"there is no such file$"):
        described(str(tmp_path / "bath.xml"))
