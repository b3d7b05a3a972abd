"""Images of meshes: Mitsuba's pixels from the same seed, and the right image after an edit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from tests.kit.axes import unit
from tests.kit.meshes import bumpy_sheet, write_binary_ply
from tests.kit.renders import box, ours, pixels, theirs

LAMP = T().translate([0, 0.8, 0]).rotate([1, 0, 0], 90).scale(0.3)
LEANING = T().translate([0, -0.2, 0]).rotate(unit(1, 0.3, 0), -60).scale(0.5)


def room(path: Path, **keys: Any) -> dict[str, Any]:
    """The Cornell box with a crumpled sheet in it, lit by another one."""

    def edit(scene: dict[str, Any]) -> None:
        del scene["large-box"], scene["light"]
        bsdf = {
            "type": "twosided",
            "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.2, 0.1]}},
        }
        scene["sheet"] = {"type": "ply", "filename": str(path), "to_world": LEANING, "bsdf": bsdf, **keys}
        emitter = {"type": "area", "radiance": 10.0}
        scene["lamp"] = {"type": "ply", "filename": str(path), "to_world": LAMP, "emitter": emitter, **keys}

    return box(48, edit=edit)


@pytest.mark.parametrize("keys", [{}, {"face_normals": True, "flip_normals": False}])
@pytest.mark.sparse(2)
def test_meshes_and_mesh_lights_give_the_pixels_of_mitsuba(tmp_path: Path, keys: dict[str, Any]) -> None:
    pytest.importorskip("mitsuba")
    scene = room(write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(6)), **keys)
    a, b = ours(scene, spp=16), theirs(scene, spp=16)
    equal = (np.abs(a - b) <= 1e-3 * b.mean()).all(axis=-1)
    assert equal.mean() > 0.995
    assert abs(a.mean() / b.mean() - 1) < 1e-4


def test_moved_vertices_give_the_image_of_the_moved_mesh(tmp_path: Path) -> None:
    path = write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(6), normals=False)
    other = write_binary_ply(tmp_path / "other.ply", bumpy_sheet(6, seed=1), normals=False)
    scene, wanted = djpt.load_dict(room(path)), djpt.load_dict(room(other))
    before = pixels(djpt.render(scene, spp=4))
    params, target = djpt.traverse(scene), djpt.traverse(wanted)
    for key in ("sheet.vertex_positions", "lamp.vertex_positions", "sheet.vertex_texcoords", "lamp.vertex_texcoords"):
        params[key] = target[key]
    params.update()
    after, expected = pixels(djpt.render(scene, spp=4)), pixels(djpt.render(wanted, spp=4))
    assert np.abs(before - expected).max() > 0.1
    assert (np.abs(after - expected) <= 1e-4).all(axis=-1).mean() > 0.999


def test_moving_vertices_compiles_no_kernel_for_rendering(tmp_path: Path) -> None:
    scene = djpt.load_dict(room(write_binary_ply(tmp_path / "sheet.ply", bumpy_sheet(6))))
    params = djpt.traverse(scene)

    def kernels() -> set[Any]:
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
            dr.kernel_history_clear()
            dr.eval(djpt.render(scene, spp=2))
            dr.sync_thread()
            return {entry["hash"] for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT}

    first = kernels()
    params["lamp.vertex_positions"] = np.array(params["lamp.vertex_positions"]) * 0.99
    params.update()
    assert kernels() <= first


def test_walls_with_a_zero_in_their_normals_give_the_pixels_of_mitsuba(tmp_path: Path) -> None:
    """A normal's z may be -0, which is no negative number: its tangents are those of +0."""
    pytest.importorskip("mitsuba")
    wall = tmp_path / "wall.obj"
    wall.write_text("v -1 1 -1\nv -1 1 1\nv -1 -1 1\nv -1 -1 -1\nf 1 2 3\nf 1 3 4\n")

    def edit(scene: dict[str, Any]) -> None:
        white = {"type": "diffuse", "reflectance": 0.8}
        for name in ("red-wall", "green-wall"):
            side = T().scale([1.0 if name == "red-wall" else -1.0, 1, 1])
            flipped = name == "green-wall"
            scene[name] = {
                "type": "obj", "filename": str(wall), "to_world": side, "flip_normals": flipped, "bsdf": white,
            }  # fmt: skip

    scene = box(32, edit=edit)
    a, b = ours(scene, spp=8), theirs(scene, spp=8)
    assert (np.abs(a - b) <= 1e-3 * b.mean()).all(axis=-1).mean() > 0.995
