"""Families of cases: descriptions, scene files, damaged files, tangles, and calls with any arguments."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st

from tests.fuzz.cases import Case
from tests.fuzz.declarations import KINDS
from tests.fuzz.models import model_files
from tests.fuzz.mutations import damaged
from tests.fuzz.nodes import plugin, scene
from tests.fuzz.seeds import READERS, seed_files
from tests.fuzz.values import NONSENSE, Code
from tests.fuzz.xml_texts import xml_text

__all__ = ["FAMILIES", "WEIGHTS"]


def label(node: Any) -> str:
    """How messages about a description begin."""
    kind = node.get("type") if isinstance(node, dict) else None
    return kind.strip("'") if isinstance(kind, str) and kind else "scene"


def used_files(text: str) -> dict[str, bytes]:
    """The valid files that a program names."""
    return {name: content for name, content in seed_files().items() if name in text}


def loads(node: Any) -> Case:
    """Load a description."""
    code = f"djpt.load_dict({node!r})"
    # An expression may be anything, also a description that names itself otherwise.
    keys = [f"{key}:" for key in node] if isinstance(node, dict) else []  # messages of scenes may begin with ids
    names = ("",) if isinstance(node, Code) else (label(node), "scene", "load_dict", *keys)
    return Case(code, used_files(code), names)


@st.composite
def plugins(draw: st.DrawFn) -> Case:
    """One plugin, and what is nested in it."""
    return loads(draw(st.sampled_from(KINDS).flatmap(plugin)))


@st.composite
def scenes(draw: st.DrawFn) -> Case:
    """A scene that is only loaded."""
    return loads(draw(scene()))


@st.composite
def images(draw: st.DrawFn) -> Case:
    """A scene of ordinary numbers, rendered."""
    code = f"image = djpt.render(djpt.load_dict({draw(scene(wild=False))!r}), spp=2, seed=1)"
    return Case(code, used_files(code), ("scene",), finite=True)


@st.composite
def xml(draw: st.DrawFn) -> Case:
    """A scene file."""
    text = xml_text(draw(scene(wild=draw(st.booleans())))).encode("utf-8", "replace")
    if draw(st.booleans()):
        text = draw(damaged(text))
    files = {**used_files(text.decode("utf-8", "replace")), "scene.xml": text}
    trusted = draw(st.booleans())
    return Case(f"djpt.load_file('scene.xml', trusted={trusted})", files, ("scene.xml", "shape0", "shape1", "fog"))


@st.composite
def files(draw: st.DrawFn) -> Case:
    """A damaged file, read."""
    name = draw(st.sampled_from(sorted(READERS)))
    reader = draw(st.sampled_from(READERS[name]))
    contents = {**used_files(reader), name: draw(damaged(seed_files()[name]))}
    return Case(reader, contents, (name, "scene", "'filename'", "ellipsoids."))


@st.composite
def models(draw: st.DrawFn) -> Case:
    """A model of which one file is damaged."""
    names = sorted(model_files())
    quick = [name for name in names if ".usd" not in name]  # USD is read in processes of its own
    name = draw(st.sampled_from(names if draw(st.integers(0, 9)) == 0 else quick))
    contents = dict(model_files()[name])
    hurt = draw(st.sampled_from(sorted(contents)))
    contents[hurt] = draw(damaged(contents[hurt]))
    parameters = draw(st.sampled_from(["", ", trusted=False", ", up='z', cull=True"]))
    return Case(f"djpt.load_file({name!r}{parameters})", contents, (name,), alone=True)


@st.composite
def tangles(draw: st.DrawFn) -> Case:
    """Dicts that stand in several places, or in themselves, chains of references, and deep nesting."""
    kind = draw(st.sampled_from(["twosided", "mask", "scene", "merge", "bumpmap", "diffuse", "area"]))
    n = draw(st.sampled_from([1, 2, 5, 12, 40, 3000]))
    copies = draw(st.integers(1, 3))
    entries = ", ".join(f"'{key}': node" for key in "abc"[:copies])
    lines = ["node = {'type': 'diffuse'}", f"for _ in range({n}):", f"    node = {{'type': {kind!r}, {entries}}}"]
    end = draw(st.sampled_from(["", "node['z'] = node", "node = {'type': 'scene', 'x': node, 'y': node}", "chain"]))
    if end == "chain":
        last = draw(st.sampled_from(["r0", "nothing", f"r{n - 1}"]))
        lines = [
            f"node = {{f'r{{i}}': {{'type': 'ref', 'id': f'r{{i + 1}}'}} for i in range({n})}}",
            f"node |= {{'type': 'scene', 'r{n}': {{'type': 'ref', 'id': {last!r}}}}}",
        ]
    elif end:
        lines.append(end)
    return Case("\n".join([*lines, "djpt.load_dict(node)"]), {}, (kind, "scene", "diffuse"))


BOX = """d = djpt.cornell_box()
d['sensor']['film'] |= {'width': 8, 'height': 8}
scene = djpt.load_dict(d)
"""
ARGUMENTS = (
    "spp",
    "seed",
    "sensor",
    "integrator",
    "seed_grad",
    "spp_grad",
    "schedule",
    "progress",
    "pass_spp",
    "params",
)
NUMBERS = (
    "0",
    "1",
    "3",
    "2**31",
    "2**32",
    "2**32 - 1",
    "2**64",
    "-1",
    "1.5",
    "1e10",
    "True",
    "np.uint32(2)",
    "djpt.UInt32(2)",
    "'flat'",
    "'machine'",
    "'wave'",
    "'auto'",
    "djpt.UInt32([1, 2])",
    "np.array([1])",
    "scene",
    "scene.integrator()",
    "scene.sensors()[0]",
    "djpt.traverse(scene)",
    "scene.sensors()[0].film()",
)
VERBS = (
    "djpt.write({a}, {b})",
    "djpt.write('a.exr', {a})",
    "djpt.write('a.png', {a})",
    "djpt.Bitmap({a})",
    "djpt.read({a})",
    "djpt.load_file({a})",
    "djpt.load_string({a})",
    "djpt.load_dict({a})",
    "djpt.tonemap({a})",
    "djpt.traverse({a})",
    "djpt.channel_names(scene, {a})",
    "djpt.traverse(scene).keep({a})",
    "djpt.traverse(scene).update({a})",
    "djpt.traverse(scene)[{a}] = {b}",
    "djpt.render({a}, spp={b})",
    "djpt.VolumeGrid({a})",
    "djpt.to_xml({a})",
    "djpt.xml.dict_to_xml({a}, {b})",
    "djpt.read_metadata({a})",
    "djpt.spectrum_from_file({a})",
    "djpt.TensorFile({a})",
    "djpt.Mesh('m', {a}, {b})",
    "djpt.FileResolver({a})",
    "djpt.set_variant({a})",
    "djpt.register_bsdf({a}, {b})",
    "djpt.load_file('a.xml', root={a}, trusted={b})",
    "scene.sensors()[0].film().develop({a})",
)
"""Calls with two gaps."""


@st.composite
def calls(draw: st.DrawFn) -> Case:
    """A verb with arguments of all kinds."""
    anything = st.sampled_from([*map(str, NONSENSE), *NUMBERS])
    form = draw(st.integers(0, 2))
    if form == 0:
        names = draw(st.lists(st.sampled_from(ARGUMENTS), min_size=1, max_size=3, unique=True))
        given = ", ".join(f"{name}={draw(anything)}" for name in names)
        return Case(f"{BOX}image = djpt.render(scene, {given})", {}, names=tuple(names))
    if form == 1:
        key = draw(st.sampled_from(PARAMETERS))
        lines = ["p = djpt.traverse(scene)", f"p[{key!r}] = {draw(anything)}", "p.update()"]
        lines.append("image = djpt.render(scene, spp=1)")
        return Case(BOX + "\n".join(lines), {}, names=(key,))
    verb = draw(st.sampled_from(VERBS)).format(a=draw(anything), b=draw(anything))
    return Case(BOX + verb, {"a.xml": seed_files()["a.xml"]}, names=("",))


PARAMETERS = (
    "sensor.near_clip",
    "sensor.far_clip",
    "sensor.film.size",
    "sensor.film.crop_size",
    "sensor.film.crop_offset",
    "sensor.x_fov",
    "sensor.principal_point_offset_x",
    "sensor.to_world",
    "white.reflectance.value",
    "light.emitter.radiance.value",
    "light.emitter.sampling_weight",
    "light.to_world",
    "floor.to_world",
    "small-box.faces",
    "small-box.vertex_positions",
    "small-box.vertex_normals",
    "small-box.vertex_texcoords",
    "nothing",
)
"""Parameters of the Cornell box."""

FAMILIES: dict[str, st.SearchStrategy[Case]] = {
    "plugins": plugins(),
    "scenes": scenes(),
    "xml": xml(),
    "files": files(),
    "models": models(),
    "tangles": tangles(),
    "calls": calls(),
    "images": images(),
}

WEIGHTS = {"plugins": 30, "scenes": 15, "xml": 15, "files": 20, "models": 5, "tangles": 2, "calls": 8, "images": 5}
"""How many of a hundred cases are of each family."""
