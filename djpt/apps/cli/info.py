"""The commands ``djpt info``: what a scene consists of, and how well its triangles can be searched; ``djpt scenes``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from djpt.apps.cli import options
from djpt.apps.cli.console import Command, described_scene
from djpt.core.terminal import visible

if TYPE_CHECKING:
    from djpt.geometry.triangles import Triangles
    from djpt.scene.scene import Scene
    from djpt.shapes.base import Shape

__all__ = ["compare_structures", "describe", "info", "scenes"]


def describe(scene: Scene) -> str:
    """Describe a scene in a few lines: shapes, primitives, nodes, depth, SAH cost, memory, build time.

    The SAH cost is the number of nodes and primitives that a random line through the scene meets on
    average; see docs/theory/acceleration.md.
    """
    from djpt.shapes.shapegroup import ShapeGroup

    rows = [("shapes", counted(scene.shapes()))]
    groups = [shape for shape in scene.shapes() if isinstance(shape, ShapeGroup)]
    rows += [(f"in {visible(group.id())}", counted(group.shapes)) for group in groups]
    rows.append(("emitters", counted(scene.emitters())))
    triangles = scene.geometry.triangles
    analytic = len(scene.geometry.analytic_shapes)
    rows.append(("unrolled", f"{analytic} analytic shape{'s' * (analytic != 1)}, tested by every ray"))
    if triangles is None:
        rows.append(("triangles", "none"))
    else:
        rows += of_triangles(triangles, scene.shapes())
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join(f"{name:<{width}}{text}" for name, text in rows)


def of_triangles(triangles: Triangles, shapes: Sequence[Shape]) -> list[tuple[str, str]]:
    """Describe the BVH: (name, text) for each of its numbers."""
    nodes, depth, cost = triangles.two_level_bvh.statistics()
    stored, seen = triangles.meshes.face_count, sum(faces_of(shape) for shape in shapes)
    instanced = "" if stored == seen else f", {seen} with instances"
    return [
        ("triangles", f"{stored}{instanced}"),
        ("nodes", f"{nodes}, depth {depth}"),
        ("SAH cost", f"{cost:.2f}"),
        ("memory", f"{triangles.tree.bytes / 2**20:.1f} MiB"),
        ("built in", f"{triangles.build_seconds:.3f} s"),
    ]


def compare_structures(scene: Scene) -> str:
    """A table of acceleration structures, each built over the triangles of a scene's meshes.

    The triangles are those that are stored, without instances. See docs/theory/acceleration.md.
    """
    import numpy as np

    from djpt.geometry.accelerators.bsp import BspTree
    from djpt.geometry.accelerators.bvh import Bvh
    from djpt.geometry.accelerators.grid import UniformGrid
    from djpt.geometry.accelerators.kdtree import KdTree
    from djpt.geometry.accelerators.octree import Octree
    from djpt.geometry.accelerators.simple_bvh import SimpleBvh
    from djpt.shapes.mesh import Mesh
    from djpt.shapes.shapegroup import ShapeGroup

    shapes = [*scene.shapes(), *(s for group in scene.shapes() if isinstance(group, ShapeGroup) for s in group.shapes)]
    meshes = [shape for shape in shapes if isinstance(shape, Mesh) and len(shape.indices)]
    if not meshes:
        return "no triangles to build structures for"
    corners = np.concatenate([mesh.positions[mesh.indices] for mesh in meshes])
    kinds = {"BVH": Bvh, "simple BVH": SimpleBvh, "grid": UniformGrid, "octree": Octree, "kd-tree": KdTree}
    lines = [f"{'':<12}{'nodes':>10}{'references':>12}{'depth':>7}{'SAH cost':>10}{'MiB':>8}{'seconds':>9}"]
    for name, kind in {**kinds, "BSP tree": BspTree}.items():
        found = kind(corners).statistics()
        lines.append(
            f"{name:<12}{found.nodes:>10}{found.references:>12}{found.depth:>7}{found.sah_cost:>10.2f}"
            f"{found.bytes / 2**20:>8.1f}{found.build_seconds:>9.3f}"
        )
    return "\n".join(lines)


def faces_of(shape: Shape) -> int:
    """The number of a shape's triangles, those of instances included."""
    from djpt.shapes.instance import Instance
    from djpt.shapes.mesh import Mesh

    if isinstance(shape, Instance):
        return sum(faces_of(inner) for inner in shape.group.shapes)
    return len(shape.indices) if isinstance(shape, Mesh) else 0


def counted(plugins: Sequence[object]) -> str:
    """Count the plugins of each class: ``2 Cube, 6 Rectangle``."""
    kinds = Counter(type(plugin).__name__ for plugin in plugins)
    return ", ".join(f"{kinds[kind]} {kind}" for kind in sorted(kinds)) or "none"


@click.command("info", cls=Command, epilog=options.SCENE)
@options.scene
@options.define
@click.option("--structures", is_flag=True, help="Build other acceleration structures, too, and compare them.")
def info(scene: str, define: tuple[str, ...], structures: bool) -> None:
    """Print the contents of SCENE.

    This includes statistics of the tree over its triangles.
    """
    description = described_scene(scene, define)[1]
    import djpt

    loaded = djpt.load_dict(description)
    print(describe(loaded))
    if structures:
        print(f"\n{compare_structures(loaded)}")


@click.command("scenes", cls=Command, renders=False)
def scenes() -> None:
    """List the built-in scenes."""
    from djpt import scenes as built_in

    width = max(len(name) for name in built_in.NAMES)
    for name in built_in.NAMES:
        summary = (getattr(built_in, name).__doc__ or "").strip().splitlines()
        print(f"{name:<{width}}  {summary[0] if summary else ''}".rstrip())
