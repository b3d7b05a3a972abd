"""``djpt info``: what is said about scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
from click.testing import CliRunner

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.apps.cli.info import compare_structures, describe
from djpt.apps.cli.main import app
from tests.kit.triangle_soups import sphere


def mesh(count: int) -> djpt.Mesh:
    corners = sphere(count)
    return djpt.Mesh("ball", vertex_positions=corners.reshape(-1, 3), faces=np.arange(3 * len(corners)).reshape(-1, 3))


def rows(scene: dict[str, Any]) -> dict[str, str]:
    lines = describe(djpt.load_dict(scene)).splitlines()
    return {name.strip(): text for name, text in (line.split("  ", 1) for line in lines)}


def test_info_counts_shapes_of_a_scene_without_meshes() -> None:
    result = CliRunner().invoke(app, ["info", "cornell_box"])
    assert result.exit_code == ExitCode.DONE
    assert "2 Cube, 6 Rectangle" in result.stdout
    assert "8 analytic shapes" in result.stdout
    assert result.stdout.splitlines()[-1].split() == ["triangles", "none"]


def test_info_describes_the_tree_of_a_mesh() -> None:
    ball = mesh(2000)
    said = rows({**djpt.cornell_box(), "ball": ball})
    assert said["triangles"].strip() == str(len(ball.indices))
    nodes, depth = (int(word.split()[-1]) for word in said["nodes"].split(","))
    # Nodes have up to eight children each, leaves up to eight triangles.
    assert len(ball.indices) / 64 <= nodes < len(ball.indices)
    assert depth >= np.log(len(ball.indices)) / np.log(8) - 1
    assert 1 < float(said["SAH cost"]) < len(ball.indices) / 20
    assert float(said["memory"].split()[0]) > 0.1
    assert 0 < float(said["built in"].split()[0]) < 10


def test_info_compares_acceleration_structures() -> None:
    lines = compare_structures(djpt.load_dict({**djpt.cornell_box(), "ball": mesh(300)})).splitlines()
    assert [line[:12].strip() for line in lines[1:]] == ["BVH", "simple BVH", "grid", "octree", "kd-tree", "BSP tree"]
    for line in lines[1:]:
        nodes, references, depth, cost, *_ = (float(word) for word in line[12:].split())
        assert nodes > 10 and references >= 288 and depth >= 1 and 1 < cost < 100
    result = CliRunner().invoke(app, ["info", "cornell_box", "--structures"])
    assert result.stdout.splitlines()[-1] == "no triangles to build structures for"


def test_info_explains_unknown_scenes() -> None:
    result = CliRunner().invoke(app, ["info", "cornel_box"])
    assert result.exit_code == ExitCode.BAD_INPUT
    assert "did you mean 'cornell_box'" in result.stderr
