"""What CONTRIBUTING.md says is done, step by step, in a copy of the tree, and gives plugins that pass the tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kit.documents import walks
from tests.kit.processes import ROOT

FOLDERS = ("djpt", "integrators", "materials", "scenes", "validation", "tests")
LINKED = FOLDERS[1:-1]

RENDERS = """
import math
import numpy as np
import djpt
from djpt.core.transforms import ScalarTransform4f as T

ALBEDO, DISTANCE, SCALE = 0.4, 2.0, 3.0
EYE = T().look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0])


def scene(integrator, wall, bsdf, fov=0.1, size=2):
    \"\"\"A wall, seen and lit from the same point at DISTANCE in front of it.\"\"\"
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    return djpt.load_dict({
        "type": "scene",
        "integrator": {"type": integrator},
        "sensor": {"type": "perspective", "fov": fov, "to_world": EYE, "film": film},
        "wall": {"bsdf": bsdf, **wall},
        "lamp": {"type": "point", "position": [0, 0, DISTANCE], "intensity": 1.0},
    })


rectangle, dust = {"type": "rectangle"}, {"type": "lommel_seeliger", "albedo": ALBEDO}
# Around the origin, of which the triangle covers the corner of a square.
triangle = {"type": "triangle", "to_world": T().translate([-1, -1, 0]).scale(SCALE)}

# L = f cos I / d^2 with f = albedo / (8 pi) at normal incidence and exitance.
expected = ALBEDO / (8 * math.pi) / DISTANCE**2
for wall in (rectangle, triangle):
    lit = scene("path", wall, dust)
    np.testing.assert_allclose(np.array(djpt.render(lit, spp=4)), expected, rtol=1e-4)
    params = djpt.traverse(lit)
    (key,) = (key for key in params.keys() if "albedo" in key)
    params[key] = 2 * ALBEDO
    params.update()
    np.testing.assert_allclose(np.array(djpt.render(lit, spp=4)), 2 * expected, rtol=1e-4)

    facing = scene("facing_ratio", wall, dust)
    np.testing.assert_allclose(np.array(djpt.render(facing, spp=1)), 1, rtol=1e-5)

# The film shows 2 x 2 units, of which half a unit is beyond the triangle's edge x + y = 1.
wide = scene("facing_ratio", triangle, dust, fov=2 * math.degrees(math.atan(1 / DISTANCE)), size=64)
seen = np.array(djpt.render(wide, spp=16))
covered = (seen[..., 0] > 0.3).mean()
np.testing.assert_allclose(covered, 7 / 8, atol=0.01)

print(djpt.materials.LommelSeeliger.__name__, djpt.shapes.Triangle.__name__, djpt.integrators.FacingRatio.__name__)
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree in which the page has been followed."""
    if not (ROOT / "CONTRIBUTING.md").exists():
        pytest.skip("not a working copy of the repository")
    root = tmp_path_factory.mktemp("tree")
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, root / folder, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "pytest_djpt.py"):
        shutil.copy(ROOT / file, root / file)
    for step in walks():
        step.follow(root)
    return root


def run(tree: Path, *arguments: str) -> str:
    """What Python prints that finds djpt in the copy."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=tree,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def test_the_page_has_three_walks() -> None:
    files = [step.path for step in walks() if step.below is None]
    assert [Path(path).parts[-2] for path in files] == ["materials", "shapes", "integrators"]
    assert sum(step.below is not None for step in walks()) >= 3


def test_the_plugins_render(tree: Path) -> None:
    assert run(tree, "-c", RENDERS) == "LommelSeeliger Triangle FacingRatio\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "names"),
    [
        ("tests/materials/test_sampling.py", "lommel_seeliger"),
        ("tests/lights/test_sampling.py", "triangle and Directions"),
        ("tests/geometry/test_working_frame.py", "test_shapes_move and triangle"),
    ],
)
def test_the_plugins_pass_the_tests_of_their_kind(tree: Path, file: str, names: str) -> None:
    printed = run(
        tree, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "", "-k", f"{names} and not million", file
    )
    assert " passed" in printed and "failed" not in printed, printed


@pytest.mark.slow
def test_the_files_of_the_page_are_clean(tree: Path) -> None:
    """`mypy --strict` and ruff find nothing in the files of the page."""
    pytest.importorskip("mypy")
    pytest.importorskip("ruff")
    files = [step.path for step in walks() if step.below is None]
    inside = [path if path.startswith("djpt/") else f"djpt/{path}" for path in files]
    run(tree, "-m", "ruff", "check", "--no-cache", *files)
    assert "no issues found" in run(tree, "-m", "mypy", "--follow-imports=silent", *inside)
