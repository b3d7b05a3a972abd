"""Wrong scene files: every message names the file and the line, what was found and what is possible."""

from __future__ import annotations

import random
import re
import time
from pathlib import Path
from typing import Any

import pytest

import djpt
from djpt.description.xml.reader import LONGEST, MAX_FILES, MAX_INCLUDES
from djpt.description.xml.source import MAX_NESTING
from djpt.mitsuba.xml import read_file, read_string
from tests.kit.processes import ROOT


def scene(*lines: str) -> str:
    """A scene whose first given line is line 2."""
    return "\n".join(['<scene version="3.0.0">', *lines, "</scene>"])


def fails(text: str, message: str, **parameters: Any) -> None:
    with pytest.raises(djpt.DjptError) as caught:
        djpt.load_string(text, **parameters)
    assert str(caught.value).startswith(message if message.startswith("the parameter") else f"<string>{message}")


def sphere(*lines: str) -> str:
    return scene('<shape type="sphere" id="a">', *lines, "</shape>")


WRONG = {
    # ---- XML
    "not XML": ("hello", ":1: not well-formed XML: syntax error (column 1)"),
    "empty": ("", ":1: not well-formed XML: no element found"),
    "unclosed": ('<scene version="3.0.0">\n<shape>\n</scene>', ":3: not well-formed XML: mismatched tag"),
    "two roots": ('<scene version="3.0.0"/>\n<scene/>', ":2: not well-formed XML: junk after document"),
    "attribute twice": (scene('<shape type="a" type="b"/>'), ":2: not well-formed XML: duplicate attribute"),
    "too deep": ('<scene version="3.0.0">' + "\n<bsdf type='twosided'>" * 70, f":{MAX_NESTING + 1}: <bsdf>: nested"),
    "encoding": (b'<?xml version="1.0" encoding="martian"?>\n<scene version="3.0.0"/>', ":1: "),
    "bytes": (b'<scene version="3.0.0">\n\xff</scene>', ":2: not well-formed XML: not well-formed (invalid token)"),
    # ---- the outermost tag
    "no version": ("<scene/>", ":1: <scene>: the attribute 'version' is missing, such as version=\"3.0.0\""),
    "bad version": ('<scene version="three"/>', ":1: <scene>: the version must be three numbers such as 3.0.0"),
    "root is a value": ('<float version="3.0.0"/>', ":1: <float>: a scene file begins with <scene version=...>"),
    "root near miss": ('<scen version="3.0.0"/>', ":1: <scen>: a scene file begins with <scene version=...> or "),
    # ---- tags and attributes
    "unknown tag": (scene("", "<shap/>"), ":3: <shap>: unknown tag; did you mean 'shape'?"),
    "nested scene": (scene('<scene type="scene"/>'), ":2: <scene>: a scene can't be nested; to merge"),
    "no type": (scene('<shape id="a"/>'), ":2: <shape>: the attribute 'type' is missing (found: id)"),
    "unknown attribute": (scene('<shape type="sphere" nam="x"/>'), ":2: <shape>: unknown attribute 'nam'; did"),
    "transform alone": (sphere('<scale x="2"/>'), ":3: <scale>: can only stand in a <transform>"),
    "value in value": (
        sphere('<float name="radius" value="1"><float/></float>'),
        ":3: <float>: can't stand in a <float>",
    ),
    "no name": (sphere('<float value="1"/>'), ":3: <float>: the attribute 'name' is missing (found: value)"),
    "empty name": (sphere('<float name="" value="1"/>'), ":3: <float>: the name is empty"),
    "name type": (
        sphere('<string name="type" value="x"/>'),
        ":3: <string>: the name 'type' can't be used: write <shape type",
    ),
    "name with a dot": (sphere('<float name="a.b" value="1"/>'), ":3: <float>: the name 'a.b' contains a '.'"),
    "given twice": (
        sphere('<float name="radius" value="1"/>', '<float name="radius" value="2"/>'),
        ":4: 'radius' was already given (<string>:3)",
    ),
    "wrong kind": (scene('<bsdf type="sphere"/>'), ":2: <bsdf>: 'sphere' is a shape; write <shape type=...>"),
    # ---- values
    "float": (sphere('<float name="radius" value="1x"/>'), ":3: <float>: must be a number, found '1x'"),
    "float nan": (sphere('<float name="radius" value="nan"/>'), ":3: <float>: must be a number, found 'nan'"),
    "float large": (sphere('<float name="radius" value="1e99"/>'), ":3: <float>: must be finite in single precision"),
    "integer": (sphere('<integer name="radius" value="1.5"/>'), ":3: <integer>: must be a whole number, found '1.5'"),
    "boolean": (sphere('<boolean name="b" value="yes"/>'), ":3: <boolean>: must be true or false, found 'yes'"),
    "point": (sphere('<point name="center" x="1" y="2"/>'), ":3: <point>: the attribute 'z' is missing"),
    "vector": (
        sphere('<vector name="center" value="1 2"/>'),
        ":3: <vector>: 'value' must be one or three numbers, found 2",
    ),
    "mixed": (sphere('<vector name="a" value="1" x="2"/>'), ":3: <vector>: unknown attribute 'x'"),
    "rgb": (sphere('<rgb name="a" value="#ff0000"/>'), ":3: <rgb>: must be a number, found '#ff0000'"),
    "rgb of two": (sphere('<rgb name="a" value="1 2"/>'), ":3: <rgb>: must be one or three numbers, found 2"),
    "spectrum": (sphere('<spectrum name="a" value="1 2"/>'), ":3: <spectrum>: must be one number or pairs such as"),
    "spectrum of one": (sphere('<spectrum name="a" value="400:1"/>'), ":3: <spectrum>: a spectrum needs at least two"),
    "spectrum order": (sphere('<spectrum name="a" value="500:1 400:1"/>'), ":3: <spectrum>: wavelengths must increase"),
    # ---- transforms
    "operation": (
        sphere('<transform name="t">', "<rotat/>", "</transform>"),
        ":4: <rotat>: can't stand in a <transform>; did you mean 'rotate'?",
    ),
    "axis": (
        sphere('<transform name="t">', '<rotate angle="3"/>', "</transform>"),
        ":4: <rotate>: the axis has length 0",
    ),
    "no angle": (
        sphere('<transform name="t"><rotate x="1"/></transform>'),
        ":3: <rotate>: the attribute 'angle' is missing",
    ),
    "matrix": (
        sphere('<transform name="t"><matrix value="1 2 3"/></transform>'),
        ":3: <matrix>: must be 9 or 16 numbers, found 3",
    ),
    "look_at": (
        sphere('<transform name="t"><lookat origin="1 1 1" target="1 1 1"/></transform>'),
        ":3: <lookat>: look_at: origin and target",
    ),
    "look_at of two": (
        sphere('<transform name="t"><lookat origin="1 1" target="1 1 1"/></transform>'),
        ":3: <lookat>: 'origin' must be three numbers",
    ),
    "flat": (
        sphere('<transform name="to_world"><scale z="0"/></transform>'),
        ":3: scene.a: 'to_world' must be invertible",
    ),
    # ---- references
    "reference": (
        scene('<bsdf type="diffuse" id="white"/>', '<shape type="sphere"><ref id="whit"/></shape>'),
        ":3: <ref>: nothing has the id 'whit'; did you mean 'white'?",
    ),
    "reference to nothing": (scene('<ref id="a"/>'), ":2: <ref>: nothing has the id 'a'; no object has an id"),
    "id twice": (
        scene('<bsdf type="diffuse" id="a"/>', "", '<bsdf type="diffuse" id="a"/>'),
        ":4: <bsdf>: the id 'a' is already taken (<string>:2)",
    ),
    "alias": (scene('<alias id="a" as="b"/>'), ":2: <alias>: nothing above has the id 'a'"),
    "alias taken": (
        scene('<bsdf type="diffuse" id="a"/>', '<alias id="a" as="a"/>'),
        ":3: <alias>: the id 'a' is already taken",
    ),
    "circle": (
        scene('<bsdf type="twosided" id="a">', '<ref id="a"/>', "</bsdf>"),
        ":2: scene.a: references form a cycle",
    ),
    # ---- what the loader finds
    "unknown key": (
        sphere("", '<float name="radus" value="1"/>'),
        ":4: scene.a: unknown key 'radus' of shape 'sphere'; did you mean 'radius'?",
    ),
    "unknown plugin": (
        scene('<shape type="spher"/>'),
        ":2: <shape>: unknown shape 'spher'; did you mean 'sphere'? (possible: sphere, ",
    ),
    "range": (sphere('<float name="radius" value="-1"/>'), ":3: scene.a: 'radius' must be greater than 0, found -1"),
    "wrong type": (
        sphere("", '<string name="radius" value="big"/>'),
        ":4: scene.a: 'radius' must be a float, found str 'big'",
    ),
    "colour": (
        scene('<bsdf type="diffuse" id="m">', '<rgb name="reflectance" value="2"/>', "</bsdf>"),
        ":3: scene.m: 'reflectance' must lie in [0, 1], found 2",
    ),
    "nested node": (
        sphere('<bsdf type="diffuse">', '<float name="reflectence" value="1"/>', "</bsdf>"),
        ":4: scene.a.bsdf: unknown key 'reflectence'",
    ),
    "missing key": (scene('<shape type="obj" id="m"/>'), ":2: scene.m: 'obj' needs the key 'filename'"),
    # ---- parameters and files
    "missing parameter": (
        sphere('<default name="size" value="1"/>', '<float name="radius" value="$siz"/>'),
        ":4: <float>: 'value': unknown parameter '$siz'; did you mean 'size'?",
    ),
    "no parameters": (
        sphere('<float name="radius" value="$r"/>'),
        ":3: <float>: 'value': unknown parameter '$r'; give r=... or write <default>",
    ),
    "braces": (
        sphere('<float name="radius" value="${r}"/>'),
        ":3: <float>: 'value': '$' without the name of a parameter; write $name",
    ),
    "dollar": (
        sphere('<string name="s" value="5 $"/>'),
        r":3: <string>: 'value': '$' without the name of a parameter; write \$",
    ),
    "mesh": (
        scene('<shape type="ply"><string name="filename" value="no.ply"/></shape>'),
        ":2: <string>: 'no.ply' doesn't exist; searched: ",
    ),
    "include": (scene('<include filename="no.xml"/>'), ":2: <include>: 'no.xml' doesn't exist; searched: "),
    "path": (scene('<path value="no"/>'), ":2: <path>: 'no' doesn't exist"),
    "path inside": (sphere('<path value="."/>'), ":3: <path>: can only stand directly in the file's outermost object"),
}


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=list(WRONG))
def test_messages(text: str, message: str) -> None:
    fails(text, message)


BOMBS = {
    "entities": '<!DOCTYPE x [<!ENTITY a "aaa"><!ENTITY b "&a;&a;&a;">]>\n<scene version="3.0.0"/>',
    "a file": '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>\n<scene version="3.0.0">&a;</scene>',
    "document type": '<!DOCTYPE scene SYSTEM "http://localhost/scene.dtd">\n<scene version="3.0.0"/>',
}


@pytest.mark.parametrize("text", BOMBS.values(), ids=list(BOMBS))
def test_document_types_and_entities_are_refused(text: str) -> None:
    fails(text, ":1: document types and entities aren't allowed in scene files")


def test_defaults_made_of_defaults_dont_explode() -> None:
    lines = ['<default name="p0" value="laughing out loud"/>']
    lines += [f'<default name="p{i}" value="{f"$p{i - 1} " * 10}"/>' for i in range(1, 30)]
    start = time.process_time()
    fails(scene(*lines), f":7: <default>: 'value': longer than {LONGEST} characters after substitution")
    assert time.process_time() - start < 2


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sp": 1}, ": the parameter 'sp' isn't used; did you mean 'spp'? (possible: spp)"),
        ({"spp": [1, "a"]}, "the parameter 'spp' must be a string, a number, a boolean or several numbers, found list"),
        ({"spp": None}, "the parameter 'spp' must be a string, a number, a boolean or several numbers, found None"),
    ],
)
def test_wrong_parameters(given: dict[str, Any], message: str) -> None:
    text = sphere('<default name="spp" value="1"/>', '<float name="radius" value="$spp"/>')
    assert read_string(text, spp=2)["a"]["radius"] == 2
    fails(text, message, **given)


def test_a_parameter_for_a_file_without_any() -> None:
    fails(scene(), ": the parameter 'x' isn't used; the file has no parameters", x=1)


# ---------------------------------------------------------------- files


def write(folder: Path, **files: str) -> Path:
    """Write scenes; the path of the one called `main`."""
    for name, body in files.items():
        (folder / f"{name}.xml").write_text(f'<scene version="3.0.0">\n{body}\n</scene>')
    return folder / "main.xml"


def test_includes_in_a_circle(tmp_path: Path) -> None:
    main = write(
        tmp_path, main='<include filename="b.xml"/>', b='\n<include filename="c.xml"/>', c='<include filename="b.xml"/>'
    )
    with pytest.raises(djpt.SceneError, match=r"in a cycle: b\.xml -> c\.xml -> b\.xml") as caught:
        djpt.load_file(main)
    assert str(caught.value).startswith(f"{tmp_path}/c.xml:2: <include>: ")


def test_a_file_that_includes_itself_by_another_name(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    main = write(tmp_path / "x", main='<include filename="../x/main.xml"/>')
    with pytest.raises(djpt.SceneError, match=r"in a cycle: main\.xml -> main\.xml"):
        djpt.load_file(main)


def test_includes_nested_too_deep(tmp_path: Path) -> None:
    files = {f"f{i}": f'<include filename="f{i + 1}.xml"/>' for i in range(30)}
    main = write(tmp_path, main='<include filename="f0.xml"/>', **files)
    with pytest.raises(djpt.SceneError, match=f"includes are nested deeper than {MAX_INCLUDES} levels"):
        djpt.load_file(main)


def test_includes_of_includes_dont_explode(tmp_path: Path) -> None:
    files = {f"f{i}": f'<include filename="f{i + 1}.xml"/>\n' * 10 for i in range(10)}
    main = write(tmp_path, main='<include filename="f0.xml"/>', f10="", **files)
    with pytest.raises(djpt.SceneError, match=f"more than {MAX_FILES} files"):
        djpt.load_file(main)


def test_errors_in_an_included_file_name_that_file(tmp_path: Path) -> None:
    main = write(
        tmp_path,
        main='<include filename="b.xml"/>',
        b='\n<shape type="sphere" id="a"><float name="radus" value="1"/></shape>',
    )
    with pytest.raises(djpt.SceneError, match=re.escape(f"{tmp_path}/b.xml:3: scene.a: unknown key 'radus'")):
        djpt.load_file(main)


def test_ids_of_two_files_may_not_clash(tmp_path: Path) -> None:
    main = write(
        tmp_path, main='<bsdf type="diffuse" id="m"/>\n<include filename="b.xml"/>', b='<bsdf type="diffuse" id="m"/>'
    )
    with pytest.raises(djpt.SceneError, match=re.escape(f"b.xml:2: <bsdf>: the id 'm' is already taken ({main}:2)")):
        djpt.load_file(main)


def test_files_that_cant_be_read(tmp_path: Path) -> None:
    with pytest.raises(djpt.FileError, match=r"can't read '.*nothing\.xml': there is no such file"):
        djpt.load_file(tmp_path / "nothing.xml")
    with pytest.raises(djpt.FileError, match="it is a folder"):
        djpt.load_file(tmp_path)
    with pytest.raises(djpt.FileError, match="found int 3"):
        djpt.load_file(3)  # type: ignore[arg-type]
    with pytest.raises(djpt.SceneError, match="found int 3"):
        djpt.load_string(3)  # type: ignore[arg-type]


@pytest.mark.parametrize("line", ["400", "400 x", "400 1 2"])
def test_spectrum_files_name_their_line(tmp_path: Path, line: str) -> None:
    (tmp_path / "s.spd").write_text(f"# nm value\n{line}\n")
    main = write(tmp_path, main='<bsdf type="diffuse"><spectrum name="reflectance" filename="s.spd"/></bsdf>')
    where = f"main.xml:2: <spectrum>: {tmp_path}/s.spd:2"
    with pytest.raises(djpt.SceneError, match=re.escape(f"{where}: must be two numbers, a wavelength and a value")):
        read_file(main)


def test_a_document_keeps_its_lines_through_changes() -> None:
    document = read_string(sphere("", '<float name="radius" value="1"/>'))
    document["a"]["radius"] = -1
    with pytest.raises(djpt.SceneError, match=r"^<string>:4: scene\.a: 'radius' must be greater than 0"):
        djpt.load_dict(document)
    with pytest.raises(djpt.SceneError, match=r"^<string>:4: scene\.a: 'radius'"):
        djpt.load_dict(document.copy())


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_file_is_read_or_refused_with_a_message(seed: int) -> None:
    pieces = re.findall(r"\w+|\W", (ROOT / "scenes" / "cornell_box.xml").read_text())
    odd = ["$", '"', "<", ">", "&", "nan", ".", "\\", "a.b", "type", "id", "\x00", "1e39", "$res", *pieces]
    choose = random.Random(seed)
    refused = 0
    for _ in range(60):
        damaged = list(pieces)
        for _ in range(choose.randint(1, 3)):
            damaged[choose.randrange(len(damaged))] = choose.choice(odd)
        try:
            read_string("".join(damaged))
        except djpt.DjptError as error:
            refused += 1
            assert re.match(r"<string>:\d+: ", str(error)), error
    assert 20 < refused < 60
