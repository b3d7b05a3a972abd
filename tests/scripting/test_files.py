"""Where scripts let files be looked for."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import djpt
from djpt.errors import FileError

XML = '<scene version="3.0.0"><shape type="ply"><string name="filename" value="one.ply"/></shape></scene>'


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "scene.xml").write_text(XML)
    mesh = djpt.Mesh("one", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    (tmp_path / "meshes").mkdir()
    mesh.write_ply(tmp_path / "meshes" / "one.ply")
    before = djpt.file_resolver()
    djpt.set_file_resolver(djpt.FileResolver(before))
    yield tmp_path
    djpt.set_file_resolver(before)


def test_descriptions_look_where_the_resolver_says(folder: Path) -> None:
    plugin = {"type": "ply", "filename": "one.ply"}
    with pytest.raises(FileError, match=r"'scene.xml'"):
        djpt.load_file("scene.xml")
    djpt.file_resolver().append(folder)
    with pytest.raises(djpt.SceneError, match=r"'one.ply' doesn't exist; searched: "):
        djpt.load_file("scene.xml")
    djpt.Thread.thread().file_resolver().prepend(str(folder / "meshes"))
    assert len(djpt.load_file("scene.xml").shapes()) == 1
    assert len(djpt.load_string(XML).shapes()) == 1
    assert djpt.load_dict(plugin).class_name() == "PLYMesh"


def test_the_list_of_directories() -> None:
    resolver = djpt.FileResolver()
    assert list(resolver) == [Path.cwd()] and resolver.resolve("nothing") == Path("nothing")
    resolver.append("b")
    resolver.prepend("a")
    resolver[2] = "c"
    del resolver[1]
    assert [str(p) for p in resolver] == ["a", "c"] and len(djpt.FileResolver(resolver)) == 2
    resolver.clear()
    assert len(resolver) == 0
    with pytest.raises(FileError, match=r"expected a djpt\.FileResolver, found str"):
        djpt.set_file_resolver("here")
