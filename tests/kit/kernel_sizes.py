"""The sizes of some kernels in operations of Dr.Jit, and of compiled functions in lines of LLVM's language.

    python -m tests.kit.kernel_sizes            prints them beside those of the table
    python -m tests.kit.kernel_sizes --write    replaces the table: say in the commit why a kernel grew

They don't depend on the load of the machine, on its processor or on the version of LLVM: kernels are recorded for eight
lanes and two threads.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import djpt
from tests.kit.quick_kernels import keep_apart, skip_passes

__all__ = ["TABLE", "TOLERANCE", "measured", "verdict"]

TABLE = Path(__file__).parents[1] / "schedules" / "kernel_sizes.json"

TOLERANCE = 0.03
"""The relative change of a kernel that passes without a word."""

COMMAND = "python -m tests.kit.kernel_sizes --write"


def cornell_box(integrator: str = "path", rfilter: str = "box", **nodes: Any) -> dict[str, Any]:
    """The Cornell box at 32 x 32 pixels, with other nodes."""
    scene = djpt.cornell_box()
    scene["integrator"] = {"type": integrator, **({} if integrator == "direct" else {"max_depth": 8})}
    scene["sensor"]["film"].update(width=32, height=32, rfilter={"type": rfilter})
    return {**scene, **nodes}


def ball(**bsdf: Any) -> dict[str, Any]:
    """A ball of a material under a white sky."""
    from tests.kit.media_scenes import lit_ball

    return lit_ball(None, bsdf=bsdf, integrator="path", max_depth=8)


def bumpy_ball(folder: Path, integrator: str = "path") -> dict[str, Any]:
    """A bumpy ball of triangles with a texture in the Cornell box."""
    from tests.kit.mesh_scenes import ball_file

    texture = {"type": "checkerboard", "to_uv": djpt.ScalarTransform4f().scale([4, 4, 1])}
    bsdf = {"type": "diffuse", "reflectance": texture}
    small = djpt.ScalarTransform4f().scale(0.3)
    return cornell_box(
        integrator, ball={"type": "ply", "filename": ball_file(folder), "to_world": small, "material": bsdf}
    )


def image(description: dict[str, Any]) -> Callable[[], Any]:
    """An action that renders an image."""
    scene = djpt.load_dict(description)
    return lambda: djpt.render(scene, spp=4)


def gradient(description: dict[str, Any], key: str) -> Callable[[], Any]:
    """An action that renders an image and its reverse-mode derivative by a parameter."""
    import drjit as dr

    scene = djpt.load_dict(description)
    params = djpt.traverse(scene)

    def action() -> None:
        dr.enable_grad(params[key])
        params.update()
        dr.backward(dr.sum(djpt.render(scene, params, spp=4), axis=None))

    return action


def actions(folder: Path) -> dict[str, Callable[[], Any]]:
    """What is recorded, by name."""
    from tests.kit.media_scenes import fog, foggy_room, lit_ball

    red = "red.reflectance.value"
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.2}
    coat = {"type": "principled", "metallic": 0.3, "roughness": 0.4, "clearcoat": 0.5}
    smoke = {"type": "heterogeneous", "albedo": 0.8, "sigma_t": {"type": "constvolume", "value": 0.5}}
    return {
        "Cornell box, box filter": image(cornell_box()),
        "Cornell box, gaussian filter": image(cornell_box(rfilter="gaussian")),
        "Cornell box, direct light": image(cornell_box("direct")),
        "Cornell box, bdpt": image(cornell_box("bdpt")),
        "Cornell box, gradient by a paint": gradient(cornell_box("prb"), red),
        "Cornell box, gradient by a paint, gaussian filter": gradient(cornell_box("prb", "gaussian"), red),
        "textured mesh": image(bumpy_ball(folder)),
        "textured mesh, gradient by a paint": gradient(bumpy_ball(folder, "prb"), red),
        "ball of glass": image(ball(type="dielectric")),
        "ball of rough gold": image(ball(**gold)),
        "ball of principled": image(ball(**coat)),
        "Cornell box in fog": image(foggy_room(fog(0.2), around=True)),
        "ball of smoke": image(lit_ball(smoke, max_depth=8)),
    }


def operations(action: Callable[[], Any]) -> int:
    """The operations of all kernels that an action launches, each counted once."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        action()
        dr.sync_thread()
        kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    return sum({entry["hash"]: entry["operation_count"] for entry in kernels}.values())


def instructions(text: str) -> int:
    """The instructions of a module in LLVM's language: the indented lines."""
    return sum(line.startswith("  ") for line in text.splitlines())


def measured() -> dict[str, int]:
    """The sizes on this machine, which must not have recorded kernels before."""
    import drjit as dr

    from djpt.geometry.bvh.calls.ray import Features
    from djpt.geometry.bvh.calls.searches import SEARCHES
    from djpt.geometry.bvh.calls.traversal import CLOSEST
    from djpt.jit.backends import load_backend
    from djpt.jit.llvm.lanes import force_lanes

    load_backend()
    force_lanes(8)
    dr.set_thread_count(2)
    with tempfile.TemporaryDirectory() as folder:
        sizes = {name: operations(action) for name, action in actions(Path(folder)).items()}
    for search, function in SEARCHES.items():
        sizes[f"closest hit, {search}"] = instructions(function(CLOSEST, 8, Features()))
    return sizes


def verdict(sizes: dict[str, int], table: dict[str, int]) -> list[str]:
    """A line for each kernel whose size isn't that of the table, within `TOLERANCE`; empty if all are."""
    lines = []
    for name in sorted({*sizes, *table}):
        now, before = sizes.get(name), table.get(name)
        if now is None or before is None:
            lines.append(f"{name}: {'not in the table' if before is None else 'in the table alone'}")
        elif abs(now - before) > TOLERANCE * before:
            lines.append(f"{name}: {before} -> {now} ({now / before - 1:+.1%})")
    return lines


def main() -> int:
    """Print the sizes, and write the table if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="replace the table")
    options = parser.parse_args()
    sizes = measured()
    table = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    for name, size in sizes.items():
        print(f"{name:<52}{size:>7}{table.get(name, ''):>7}", file=sys.stderr)
    if options.write:
        TABLE.write_text(json.dumps(sizes, indent=1) + "\n")
    print(json.dumps(sizes))
    return 0


if __name__ == "__main__":  # before Dr.Jit is imported
    os.environ.pop("DJPT_RAY_QUERIES", None)
    keep_apart()
    skip_passes()
    sys.exit(main())
