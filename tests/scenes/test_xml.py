"""Scene files: what they mean, checked against Mitsuba's own parser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description.xml.reader import upgrade_name
from djpt.mitsuba.xml import read_file, read_string
from tests.kit.processes import ROOT
from tests.kit.renders import ours

CORNELL = ROOT / "scenes" / "cornell_box.xml"


def scene(body: str, version: str = "3.0.0") -> str:
    return f'<scene version="{version}">{body}</scene>'


def shape(body: str, version: str = "3.0.0", kind: str = "rectangle") -> str:
    return f'<shape type="{kind}" version="{version}">{body}</shape>'


def transform(operations: str) -> np.ndarray:
    return read_string(shape(f'<transform name="to_world">{operations}</transform>'))["to_world"].matrix


# ---------------------------------------------------------------- the Cornell box


def test_the_file_and_the_dict_are_the_same_image() -> None:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=24, height=24)
    loaded = djpt.load_file(CORNELL, res=24, spp=2)
    assert loaded.sensors()[0].sampler().sample_count() == 2
    np.testing.assert_array_equal(np.array(djpt.render(loaded, spp=4)), ours(description, spp=4))


def test_mitsuba_reads_the_same_parameters_from_the_file(mi: Any) -> None:
    theirs = dict(mi.traverse(mi.load_file(str(CORNELL), optimize=False, res="24")))
    mine = dict(djpt.traverse(djpt.load_file(CORNELL, res=24)))
    # Mitsuba's cubes are meshes.
    names = [name for name in theirs if name != "allow_thread_reordering" and "-box." not in name]
    assert len(names) > 25
    assert set(names) <= set(mine)
    for name in names:
        np.testing.assert_allclose(numbers(mine[name]), numbers(theirs[name]), atol=1e-6, err_msg=name)


def numbers(value: Any) -> np.ndarray:
    matrix = value if dr.is_array_v(value) else getattr(value, "matrix", value)
    return np.array(matrix, dtype=np.float64).squeeze()


# ---------------------------------------------------------------- transforms

OPERATIONS = [
    '<translate x="1" y="-2" z="3"/>',
    '<translate y="2"/>',
    '<translate value="1 2,3"/>',
    '<scale value="2"/>',
    '<scale x="2" z="-3"/>',
    '<scale value="1, 2, 3"/>',
    '<rotate y="1" angle="30"/>',
    '<rotate value="0 0 1" angle="-1e2"/>',
    '<rotate x="0.6" z="0.8" angle="45"/>',
    '<lookat origin="1,2,3" target="4,4,4" up="0,1,0"/>',
    '<lookat origin="1 2 3" target="-4 4 4"/>',
    '<lookat origin="0,0,1" target="0,0,-1" up="0,0,0"/>',
    '<matrix value="1 2 0 4  0 1 0 0  0 .5 1 -1  0 0 0 1"/>',
    '<matrix value="1 2 0 0 1 0 0 .5 1"/>',
    '<scale value="2"/><rotate y="1" angle="30"/><translate x="1"/>',
    '<translate x="1"/><rotate y="1" angle="30"/><scale x="2"/><lookat origin="1,2,3" target="4,4,4" up="0,1,0"/>',
    "",
]


@pytest.mark.parametrize("operations", OPERATIONS)
def test_transforms_are_mitsubas(mi: Any, operations: str) -> None:
    text = shape(f'<transform name="to_world">{operations}</transform>')
    theirs = numbers(mi.traverse(mi.load_string(text))["to_world"])
    np.testing.assert_allclose(transform(operations), theirs, atol=2e-6)


@pytest.mark.parametrize(
    "operation", ['<rotate y="1" z="1" angle="15"/>', '<rotate value="0.3 -0.2 0.1" angle="130"/>']
)
def test_an_axis_without_unit_length_is_taken_as_in_mitsuba(mi: Any, operation: str) -> None:
    text = (
        f'<scene version="3.0.0"><shape type="obj" id="s"><transform name="t">{operation}</transform></shape></scene>'
    )
    theirs = numbers(mi.parser.parse_string(mi.parser.ParserConfig("llvm_ad_rgb"), text).nodes[1].props["t"])
    with pytest.warns(UserWarning, match=r"<string>:\d+: <rotate>: the axis has the length (1\.414|0\.3742)"):
        found = transform(operation)
    np.testing.assert_allclose(found, theirs, atol=2e-6)


def test_operations_apply_in_the_order_of_the_file() -> None:
    expected = T().translate([1, 0, 0]).rotate([0, 1, 0], 30).scale(2).matrix
    np.testing.assert_allclose(transform(OPERATIONS[-3]), expected, atol=1e-15)


# ---------------------------------------------------------------- values

VALUES = {
    '<boolean name="a" value="true"/>': True,
    '<boolean name="a" value="FALSE"/>': False,
    '<integer name="a" value=" -12 "/>': -12,
    '<float name="a" value="1e-3"/>': 0.001,
    '<float name="a" value="-.5"/>': -0.5,
    '<string name="a" value="&lt;x&gt; &amp; y"/>': "<x> & y",
    '<string name="a" value=""/>': "",
    '<point name="a" x="1" y="2" z="3"/>': [1, 2, 3],
    '<vector name="a" value="1, 2 3"/>': [1, 2, 3],
    '<vector name="a" value="2"/>': [2, 2, 2],
    '<rgb name="a" value="0.1 0.2, 0.3"/>': {"type": "rgb", "value": [0.1, 0.2, 0.3]},
    '<rgb name="a" value="0.5"/>': {"type": "rgb", "value": [0.5, 0.5, 0.5]},
    '<spectrum name="a" value="0.5"/>': {"type": "spectrum", "value": 0.5},
    '<spectrum name="a" value="400:.1, 700:.2"/>': {"type": "spectrum", "value": [(400, 0.1), (700, 0.2)]},
    '<spectrum name="a" type="regular"><float name="b" value="1"/></spectrum>': {"type": "regular", "b": 1.0},
    '<transform name="a"><scale x="2"/></transform>': T().scale([2, 1, 1]),
}


@pytest.mark.parametrize(("tag", "value"), VALUES.items())
def test_value_tags(tag: str, value: Any) -> None:
    found = read_string(shape(tag))["a"]
    assert found == value
    assert type(found) is type(value)


def test_text_and_comments_mean_nothing() -> None:
    assert read_string(shape("some text <!-- and a comment -->")) == {"type": "rectangle"}


# ---------------------------------------------------------------- names and references


def test_nodes_are_called_by_id_then_by_name_then_by_tag() -> None:
    found = read_string(
        scene(
            '<shape type="sphere"/><shape type="sphere" name="ball"/><shape type="sphere" id="moon" name="x"/>'
            '<shape type="cube"><bsdf type="diffuse"/><emitter type="area" name="light"/></shape>'
            '<bsdf type="diffuse" id="Mat.001"/>'
            '<bsdf type="twosided"><bsdf type="diffuse"/><bsdf type="diffuse"/></bsdf>'
        )
    )
    assert list(found) == ["type", "shape", "ball", "moon", "shape_1", "Mat_001", "bsdf"]
    assert list(found["shape_1"]) == ["type", "bsdf", "light"]
    assert list(found["bsdf"]) == ["type", "bsdf", "bsdf_1"]
    assert found["Mat_001"] == {"type": "diffuse", "id": "Mat.001"}


BALL = '<shape type="sphere" id="s"><ref id="{}"/></shape>'
REFERENCES = {
    "before": '<bsdf type="diffuse" id="m"/>' + BALL.format("m"),
    "after": BALL.format("m") + '<bsdf type="diffuse" id="m"/>',
    "nested": '<shape type="cube"><bsdf type="diffuse" id="m"/></shape>' + BALL.format("m"),
    "alias": '<bsdf type="diffuse" id="x"/><alias id="x" as="m"/>' + BALL.format("m"),
    "dots": '<bsdf type="diffuse" id="m.1"/>' + BALL.format("m.1"),
    "an id that is a tag": BALL.format("shape") + '<shape type="sphere"/><bsdf type="diffuse" id="shape"/>',
}


@pytest.mark.parametrize("body", REFERENCES.values(), ids=list(REFERENCES))
def test_references(mi: Any, body: str) -> None:
    text = scene(body)
    loaded = djpt.load_string(text)
    ball = next(s for s in loaded.shapes() if s.id() == "s")
    shared = [s for s in loaded.shapes() if s.bsdf() is ball.bsdf()]
    assert ball.bsdf().id() in ("m", "x", "m.1", "shape")
    assert len(shared) == (2 if "cube" in text else 1)
    mi.load_string(text)  # Mitsuba agrees that the file is right


def test_names_with_dots_reach_traverse_as_in_mitsuba(mi: Any) -> None:
    text = scene('<bsdf type="diffuse" id="Mat.001"/>')
    assert "Mat.001.reflectance.value" in dict(mi.traverse(mi.load_string(text, optimize=False)))
    assert "Mat.001.reflectance.value" in djpt.traverse(djpt.load_string(text))


# ---------------------------------------------------------------- parameters

PARAMETERS = [
    ({"r": 2.5}, "$r", 2.5),
    ({"r": "2.5"}, "$r", 2.5),
    ({"r": 2}, "1$r", 12.0),
    ({"r": 1, "rad": 2, "radius": 3}, "$radius$rad$r", 321.0),
    ({"r": 1, "e": np.float32(0.5)}, "$r$e", 10.5),
]


@pytest.mark.parametrize(("given", "text", "value"), PARAMETERS)
def test_parameters(mi: Any, given: dict[str, Any], text: str, value: float) -> None:
    source = shape(f'<float name="radius" value="{text}"/>', kind="sphere")
    assert read_string(source, **given)["radius"] == value
    theirs = mi.traverse(mi.load_string(source, **{k: str(v) for k, v in given.items()}))["to_world"].matrix
    assert numbers(theirs)[0, 0] == value


def test_a_value_given_wins_over_the_default_and_the_first_default_over_later_ones() -> None:
    text = shape('<default name="r" value="1"/><default name="r" value="2"/><float name="radius" value="$r"/>')
    assert read_string(text)["radius"] == 1
    assert read_string(text, r=5)["radius"] == 5


def test_parameters_reach_every_attribute() -> None:
    text = shape(
        '<default name="n" value="center"/><point name="$n" value="$p"/><boolean name="flip_normals" value="$b"/>'
        '<bsdf type="$t" id="$i"/><transform name="to_world"><translate x="$x"/></transform>'
        r'<string name="s" value="\$x costs \$$x"/>'
    )
    found = read_string(text, p=[1, 2.5, 3], b=True, t="diffuse", i="name", x=-1)
    assert found["center"] == [1, 2.5, 3]
    assert found["flip_normals"] is True
    assert found["bsdf"] == {"type": "diffuse", "id": "name"}
    assert found["to_world"].matrix[0, 3] == -1
    assert found["s"] == "$x costs $-1"


# ---------------------------------------------------------------- includes and files


def test_an_included_scene_stands_in_place_of_the_tag(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "ball.xml").write_text(shape('<float name="radius" value="$r"/>', kind="sphere"))
    (tmp_path / "parts" / "all.xml").write_text(
        scene('<default name="r" value="3"/><bsdf type="diffuse" id="m"/><include filename="ball.xml" name="one"/>')
    )
    main = tmp_path / "main.xml"
    main.write_text(
        scene(
            '<shape type="cube"><ref id="m"/></shape><include filename="parts/all.xml"/>'
            '<include filename="parts/ball.xml"/>'
        )
    )
    found = read_file(main)
    assert list(found) == ["type", "shape", "m", "one", "shape_1"]
    assert found["one"] == found["shape_1"] == {"type": "sphere", "radius": 3.0}
    assert found.places["one"].endswith("all.xml:1")
    assert read_file(main, r=4)["one"]["radius"] == 4


def test_files_are_found_beside_the_scene_file_and_in_its_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("scene/models", "elsewhere"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("scene/models/a.ply", "elsewhere/a.ply", "elsewhere/b.ply"):
        (tmp_path / name).touch()
    mesh = '<shape type="ply" id="{0}"><string name="filename" value="{0}.ply"/></shape>'
    main = tmp_path / "scene" / "main.xml"
    main.write_text(scene('<path value="models"/>' + mesh.format("a") + mesh.format("b")))
    monkeypatch.chdir(tmp_path / "elsewhere")
    found = read_file(main)
    assert found["a"]["filename"] == str(tmp_path / "scene" / "models" / "a.ply")
    assert found["b"]["filename"] == str(tmp_path / "elsewhere" / "b.ply")


def test_a_mesh_beside_the_scene_file_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "t.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "main.xml").write_text(
        scene('<shape type="obj" id="t"><string name="filename" value="t.obj"/></shape>')
    )
    loaded = djpt.load_file(tmp_path / "main.xml")
    assert np.array(djpt.traverse(loaded)["t.vertex_positions"]).tolist() == [0, 0, 0, 1, 0, 0, 0, 1, 0]


def test_a_spectrum_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "s.spd").write_text("# nm value\n400 0.5\n\n700 0.25 # red\n")
    (tmp_path / "main.xml").write_text(shape('<spectrum name="a" filename="s.spd"/>'))
    assert read_file(tmp_path / "main.xml")["a"]["value"] == [(400, 0.5), (700, 0.25)]


# ---------------------------------------------------------------- old files


def test_old_names_become_todays(mi: Any) -> None:
    text = scene(
        '<sensor type="perspective" id="c"><float name="nearClip" value="0.5"/><string name="fovAxis" value="y"/>'
        '<float name="fov" value="50"/><transform name="toWorld"><translate z="3"/></transform></sensor>'
        '<bsdf type="diffuse" id="q"><spectrum name="diffuseReflectance" value="0.25"/></bsdf>',
        "0.6.0",
    )
    mine = djpt.traverse(djpt.load_string(text))
    theirs = dict(mi.traverse(mi.load_string(text, optimize=False)))
    for name in ("c.near_clip", "c.x_fov", "c.to_world"):
        np.testing.assert_allclose(numbers(mine[name]), numbers(theirs[name]), rtol=1e-6, err_msg=name)
    assert numbers(mine["q.reflectance.value"])[0] == numbers(theirs["q.reflectance.value"]) == 0.25


@pytest.mark.parametrize(
    ("old", "new"),
    [("toWorld", "to_world"), ("intIOR", "int_ior"), ("alphaU", "alpha_u"), ("max_depth", "max_depth"), ("ID", "ID")],
)
def test_names_with_capitals(old: str, new: str) -> None:
    assert upgrade_name(old) == new


def test_old_texture_offsets_become_a_transform() -> None:
    text = (
        '<texture type="bitmap" version="0.5.0">'
        '<float name="uoffset" value=".5"/><float name="vscale" value="3"/></texture>'
    )
    expected = T().scale([1, 3, 1]).translate([0.5, 0, 0])
    assert read_string(text)["to_uv"] == expected


def test_old_files_may_write_lookAt() -> None:
    operation = '<{} origin="0,0,0" target="0,0,1" up="0,1,0"/>'
    old = shape(f'<transform name="toWorld">{operation.format("lookAt")}</transform>', "0.5.0")
    assert (
        read_string(old)["to_world"]
        == read_string(shape(f'<transform name="to_world">{operation.format("lookat")}</transform>'))["to_world"]
    )


def test_new_files_keep_their_names() -> None:
    assert "diffuseReflectance" in read_string(
        '<bsdf type="diffuse" version="2.0.0"><float name="diffuseReflectance" value="1"/></bsdf>'
    )


def test_the_root_may_be_a_spectrum() -> None:
    lamp = djpt.load_string('<spectrum version="3.0.0" type="d65"><float name="scale" value="2"/></spectrum>')
    assert lamp.mean()[0] == 2


def test_a_film_and_its_parts_may_stand_in_the_scene() -> None:
    text = """
        <scene version="3.0.0">
            <boolean name="embree_use_robust_intersections" value="true"/>
            <sampler type="stratified" id="random"> <integer name="sample_count" value="9"/> </sampler>
            <rfilter type="box" id="flat"/>
            <film type="hdrfilm" id="pixels">
                <string name="pixel_format" value="RGBA"/> <string name="file_format" value="OpenEXR"/>
                <string name="component_format" value="Float32"/>
                <integer name="width" value="5"/> <integer name="height" value="3"/> <ref id="flat"/>
            </film>
            <sensor type="perspective"> <ref id="random"/> <ref id="pixels"/> </sensor>
            <emitter type="constant"/>
        </scene>
    """
    scene = djpt.load_string(text)
    sensor = scene.sensors()[0]
    assert (type(sensor.sampler()).__name__, sensor.sampler().sample_count()) == ("Stratified", 9)
    assert djpt.render(scene, spp=1).shape == (3, 5, 4)
