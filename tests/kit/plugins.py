"""Parameters of plugins of all kinds except BSDFs and emitters, for tests that run over the registry.

If a plugin needs parameters, or has interesting ones, add a line to EXAMPLES.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

from djpt.core.transforms import ScalarTransform4f as T
from djpt.description import registry
from djpt.jit.types import TensorXf
from tests.kit.axes import unit
from tests.kit.meshes import tetrahedron_file

__all__ = ["EXAMPLES", "SHEARED", "examples"]

SHEARED = T([[1, 0.5, 0, 0.2], [0, 0.8, 0.3, 0], [0.1, 0, 0.6, 2], [0, 0, 0, 1]])
BLOB = np.linalg.norm(np.indices((8, 8, 8)) - 3.4, axis=0)[..., None] - 2.5
EXAMPLES: dict[str, list[dict[str, Any]]] = {
    "rectangle": [{"to_world": T().translate([0.3, 0, 1.5]).rotate([1, 0, 0], 170)},
                  {"to_world": SHEARED, "flip_normals": True}],
    "cube": [{"to_world": T().translate([0.3, 0, 2.5]).rotate(unit(1, 2, 3), 50).scale([1, 0.5, 0.3])},
             {"to_world": SHEARED}],
    "sphere": [{"center": [0.5, 0.2, 2.0]}, {"radius": 3.0, "flip_normals": True}, {"center": [0, 1, 1.2]},
               {"center": [1, 2, 300.0], "radius": 2.0}],
    "disk": [{"to_world": T().translate([0.3, 0, 1.5]).rotate([1, 0, 0], 170)},
             {"to_world": SHEARED, "flip_normals": True}],
    "cylinder": [{"p0": [-1, 0.5, 2], "p1": [1, 0.2, 1.5], "radius": 0.4}, {"flip_normals": True, "p0": [0, 0, -1]}],
    "cone": [{"apex": [0.5, 0.2, 1.2], "axis": [0, 1, 1], "angle": 30}, {"flip_normals": True, "length": 2.0}],
    "paraboloid": [{"vertex": [0.5, 0.2, 2.5], "axis": [0, 1, 1], "focal_length": 0.3},
                   {"flip_normals": True, "length": 0.5}],
    "plane": [{"to_world": T().translate([0.3, 0, 1.5]).rotate([1, 0, 0], 170)},
              {"to_world": SHEARED, "flip_normals": True}],
    "cuboid": [{"min": [-1, 0.2, 2], "max": [0.5, 0.4, 3]}, {"flip_normals": True}],
    "implicit": [{"function": lambda p: dr.norm(p) - 0.7, "lipschitz": 1.0, "min": [-0.71] * 3, "max": [0.71] * 3,
                  "to_world": T().translate([0.5, 0.2, 1.8]).scale([1, 0.5, 1])},
                 {"function": lambda p: dr.norm(p) - 0.9, "flip_normals": True}],
    "torus": [{"to_world": T().translate([0.5, 0.2, 1.8]).rotate([1, 0, 0], 50)}],
    "metaballs": [{"balls": [[-0.5, 0, 2, 0.8], [0.3, 0.2, 2.2, 0.7]]}],
    "sdfgrid": [{"grid": TensorXf(BLOB.astype(np.float32)), "to_world": T().translate([-0.3, -0.4, 1.2])}],
    "ply": [{"filename": tetrahedron_file(), "face_normals": True}],
    # Meshes of other files are sampled by the same code, and these two are no lights.
    "obj": [], "serialized": [], "shapegroup": [], "instance": [], "merge": [], "deforming": [],
    # No lights: tests/geometry/test_curves.py, tests/geometry/test_ellipsoids.py.
    "linearcurve": [], "bsplinecurve": [], "ellipsoids": [], "ellipsoidsmesh": [],
    "bitmap": [{"data": np.random.default_rng(0).random((4, 8), dtype=np.float32)}],
    "mesh_attribute": [],  # only meshes have any: tests/textures/test_lookups.py
    "spectrum": [{"value": 0.4}],
    "srgb": [{"color": [0.2, 0.4, 0.9]}],
    "rawconstant": [{"value": 0.4}],
    "blackbody": [{"temperature": 3000.0}],
    "regular": [{"wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.5, 0.3"}],
    "irregular": [{"wavelengths": "400, 500, 700", "values": "0.1, 0.5, 0.3"}],
    "uniform": [{"value": 0.4}],
    "gaussian": [{}, {"stddev": 0.8}],
    "tent": [{}, {"radius": 2.0}],
    "mitchell": [{}, {"B": 0.1, "C": 0.6}],
    "lanczos": [{}, {"lobes": 2}],
}  # fmt: skip
"""Parameters to test a plugin with, by its name; one empty set if none are given."""


def examples(kind: str) -> list[Any]:
    """All of djpt's own plugins of one kind, with each set of parameters."""
    names = [name for name, factory in registry.registered(kind).items() if registry.is_own(factory)]
    return [
        pytest.param(name, {**values, "type": name}, id=f"{name}{i or ''}")
        for name in names
        for i, values in enumerate(EXAMPLES.get(name, [{}]))
    ]
