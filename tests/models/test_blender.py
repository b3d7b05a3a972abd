"""A scene of Blender, exported, loads: its meshes, materials, lights and camera."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

import djpt

BLENDER = os.environ.get("DJPT_TEST_BPY", "")
"""A Python that has the module bpy."""
SCRIPT = """import sys
sys.path.insert(0, sys.argv[1])
import bpy, export_blender
bpy.ops.wm.read_factory_settings()
bpy.data.objects["Cube"].modifiers.new("bevel", "BEVEL").width = 0.1
export_blender.export(sys.argv[2])
"""


@pytest.mark.slow
@pytest.mark.skipif(not BLENDER, reason="DJPT_TEST_BPY doesn't name a Python with the module bpy")
def test_blender_s_first_scene_is_exported(tmp_path):
    packaging = Path(__file__).parents[2] / "packaging"
    subprocess.run([BLENDER, "-c", SCRIPT, packaging, tmp_path], check=True, timeout=300)
    scene = djpt.load_file(tmp_path / "scene.xml")
    assert len(scene.emitters()) == 2 and len(scene.sensors()) == 1  # the lamp and the world
    assert max(shape.primitive_count() for shape in scene.shapes()) > 12  # more than a cube: with its modifier
