"""What `traverse` marks as differentiable is: gradients are accepted, and integrators find them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description.registry import plugin_modules
from djpt.errors import ParameterError
from djpt.jit.types import TensorXf
from djpt.rendering.gradients.leaves import attached_parameters, motion_parameters, unused_values
from tests.fuzz.seeds import seed_files

DIFFUSE = {"type": "diffuse"}
TEXELS = TensorXf(np.full((2, 2, 3), 0.5, np.float32))
HEIGHTS = {"type": "bitmap", "data": TensorXf(np.full((2, 2, 1), 0.5, np.float32)), "raw": True}
TENSOR = TensorXf(np.full((2, 2, 2, 1), 0.5, np.float32))
CLOUD = TensorXf(np.array([[0, 0, 0, 1, 1, 1, 0, 0, 0, 1]], np.float32))
FLAKES = {"type": "gridvolume", "data": TensorXf(np.tile(np.float32([0.3, 0.3, 0.3, 0, 0, 0]), (2, 2, 2, 1)))}
GROUP = {"type": "shapegroup", "ball": {"type": "sphere"}}
NEEDS: dict[str, dict[str, Any]] = {
    "bsplinecurve": {"filename": "a.txt"},
    "linearcurve": {"filename": "a.txt"},
    "ellipsoids": {"data": CLOUD},
    "ellipsoidsmesh": {"data": CLOUD},
    "deforming": {"a": {"type": "ply", "filename": "a.ply"}, "b": {"type": "ply", "filename": "a.ply"}},
    "implicit": {"function": lambda p: dr.norm(p) - 0.5},
    "metaballs": {"balls": [[0, 0, 0, 0.5]]},
    "instance": {"group": GROUP},
    "shapegroup": {"ball": {"type": "sphere"}},
    "merge": {"mesh": {"type": "ply", "filename": "a.ply"}},
    "obj": {"filename": "a.obj"},
    "ply": {"filename": "a.ply"},
    "serialized": {"filename": "a.serialized"},
    "sdfgrid": {"grid": TensorXf(np.linspace(-1, 1, 8, dtype=np.float32).reshape(2, 2, 2, 1))},
    "blendbsdf": {"a": DIFFUSE, "b": {"type": "conductor"}},
    "bumpmap": {"t": HEIGHTS, "b": DIFFUSE},
    "normalmap": {"normalmap": {"type": "bitmap", "data": TEXELS, "raw": True}, "b": DIFFUSE},
    "mask": {"b": DIFFUSE},
    "measured": {"filename": "a.bsdf"},
    "twosided": {"b": DIFFUSE},
    "envmap": {"data": TensorXf(np.ones((4, 8, 3), np.float32))},
    "bitmap": {"data": TEXELS},
    "blackbody": {"temperature": 5000.0},
    "irregular": {"wavelengths": "400, 500, 700", "values": "0.1, 0.2, 0.3"},
    "regular": {"wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.2, 0.3"},
    "mesh_attribute": {"name": "vertex_color"},
    "rawconstant": {"value": 0.5},
    "rgb": {"value": [0.5, 0.4, 0.3]},
    "spectrum": {"value": 0.5},
    "srgb": {"color": [0.5, 0.4, 0.3]},
    "uniform": {"value": 0.5},
    "blendphase": {"a": {"type": "isotropic"}, "b": {"type": "hg"}},
    "sggx": {"S": FLAKES},
    "tabphase": {"values": "0.5, 1, 1.5"},
    "gridvolume": {"data": TENSOR},
}
"""What plugins need besides their type."""


def scene_of(kind: str, name: str) -> dict[str, Any]:
    """A scene in which a plugin is used."""
    node = {"type": name, **NEEDS.get(name, {})}
    triangle = djpt.Mesh("x", np.eye(3, dtype=np.float32), np.array([[0, 1, 2]]))
    triangle.add_attribute("vertex_color", 3, np.full(9, 0.5, np.float32))
    match kind:
        case "shape":
            return {"x": node, "group": GROUP} if name == "shapegroup" else {"x": node}
        case "bsdf":
            return {"x": {"type": "rectangle", "bsdf": node}}
        case "emitter" if name in ("area", "directionalarea"):
            return {"x": {"type": "rectangle", "emitter": node}}
        case "emitter":
            return {"x": node, "floor": {"type": "rectangle"}}
        case "texture" if name == "mesh_attribute":
            triangle.set_bsdf(djpt.load_dict({**DIFFUSE, "reflectance": node}))
            return {"x": triangle}
        case "texture":
            return {"x": {"type": "rectangle", "bsdf": {**DIFFUSE, "reflectance": node}}}
        case "medium":
            return {"x": {"type": "cube", "bsdf": {"type": "null"}, "interior": node}}
        case "phase":
            return {"x": {"type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "homogeneous", "p": node}}}
        case _:
            medium = {"type": "heterogeneous", "sigma_t": node}
            return {"x": {"type": "cube", "to_world": T().scale(2), "bsdf": {"type": "null"}, "interior": medium}}


PLUGINS = [
    (kind, name)
    for kind in ("shape", "bsdf", "emitter", "texture", "medium", "phase", "volume")
    for name, place in sorted(plugin_modules().items())
    if place.kind == kind
]


@pytest.mark.sparse(3)
@pytest.mark.parametrize(("kind", "name"), PLUGINS)
def test_what_is_marked_has_derivatives(kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file, content in seed_files().items():
        (tmp_path / file).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    scene = djpt.load_dict({"type": "scene", **scene_of(kind, name)})
    params = djpt.traverse(scene)
    for key in [key for key in params if params.flags(key).differentiable]:
        value = params[key]
        dr.enable_grad(value)
        params[key] = value
        params.set_dirty(key)
        params.update()
        view = scene.replace(all_media=True)
        found = attached_parameters(view)
        assert [*found, *motion_parameters(view), *unused_values(view, found)], f"{key} reaches no integrator"
        dr.disable_grad(value)
        params[key] = value
        params.set_dirty(key)
        params.update()


def test_nothing_follows_what_is_instanced() -> None:
    """Gradients by the place of a shape in a group used to be lost without a word."""
    scene = djpt.load_dict(
        {"type": "scene", "group": GROUP, "x": {"type": "instance", "g": {"type": "ref", "id": "group"}}}
    )
    params = djpt.traverse(scene)
    key = next(key for key in params if key.endswith("ball.to_world"))
    assert not params.flags(key).differentiable
    dr.enable_grad(params[key])
    with pytest.raises(ParameterError, match=r"ball\.to_world"):
        params.update()


@pytest.mark.parametrize("name", ["sphere", "disk", "rectangle", "cylinder", "torus"])
def test_shapes_with_silhouettes_are_marked(name: str) -> None:
    params = djpt.traverse(djpt.load_dict({"type": name}))
    assert params.flags("to_world").differentiable


def test_the_vertices_of_a_cube_are_marked() -> None:
    params = djpt.traverse(djpt.load_dict({"type": "cube"}))
    listed = [line for line in str(params).splitlines() if "vertex_positions" in line]
    assert params.flags("vertex_positions").differentiable and "∂" in listed[0]


def test_metaballs_are_not_marked() -> None:
    """Nothing follows the outlines of surfaces that are given by a function."""
    params = djpt.traverse(djpt.load_dict({"type": "metaballs", "balls": [[0, 0, 0, 1]]}))
    listed = [line for line in str(params).splitlines() if "to_world" in line]
    assert not params.flags("to_world").differentiable and "∂" not in listed[0]
