"""Memory is bounded by the size of the image, not by the number of samples.

4096 x 4096 pixels at 16 spp and 1024 x 1024 at 4096 must fit in 1 GiB, files included, and adaptive renders of
1024 x 1024 in half of that. Each render runs in a process of its own, whose peak resident size Linux reports. Bands and
passes are of equal size at any spp, so the peak of a few passes is that of all of them; the real thing is rendered with
a short path.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.kit.mesh_scenes import ball_file

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")

GIB = 2**30
BUDGET = GIB
SIZE = 1024

SCRIPT = """
import json, sys
import djpt  # first: it finds the LLVM library that Dr.Jit opens
import drjit as dr
import numpy as np

def peak():
    # Not getrusage: its maximum begins with that of the parent process.
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))

options = json.loads(sys.argv[1])
description = djpt.cornell_box()
if options["mesh"]:
    white = {"type": "ref", "id": "white"}
    description["mesh"] = {"type": "ply", "filename": options["mesh"], "bsdf": white}
description["sensor"]["film"].update(width=options["size"], height=options["size"])
description["sensor"]["film"]["rfilter"] = {"type": options["rfilter"]}
description["integrator"] = options["integrator"]
scene = djpt.load_dict(description)
params = djpt.traverse(scene)
if options["gradient"]:
    dr.enable_grad(params["red.reflectance.value"], params["white.reflectance.value"])
    params.update()
peaks = []
for spp in options["spp"]:
    image = djpt.render(scene, params, spp=spp, schedule=options["schedule"])
    if options["gradient"]:
        dr.backward(dr.mean(image.array))
    mean = float(image.numpy().mean())
    if options["file"]:
        djpt.write(options["file"], image)
    del image
    peaks.append(peak())
print(json.dumps([peaks, mean]))
"""


def peaks(
    *spp: int,
    rfilter: str = "box",
    schedule: str = "auto",
    size: int = SIZE,
    gradient: bool = False,
    file: Path | None = None,
    mesh: Path | str = "",
    **integrator: Any,
) -> list[int]:
    """Peak memory in bytes after each of several renders in a fresh process."""
    integrator = {"type": "path", "max_depth": 2, **integrator}
    options = {"spp": spp, "rfilter": rfilter, "schedule": schedule, "size": size, "gradient": gradient}
    files = {"file": str(file or ""), "mesh": str(mesh)}
    arguments = json.dumps({**options, **files, "integrator": integrator})
    done = subprocess.run([sys.executable, "-c", SCRIPT, arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found, mean = json.loads(done.stdout.splitlines()[-1])
    assert 0 < mean < 1
    return found


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**29,) * 2)
import djpt
description = djpt.cornell_box()
description["sensor"]["film"].update(width=int(sys.argv[1]), height=int(sys.argv[1]))
description["integrator"]["max_depth"] = 1
try:
    djpt.render(djpt.load_dict(description), spp=1)
except djpt.RenderError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("size", "message"),
    [
        (8000, "takes about 1.3 GiB; "),
        (20000, "takes about 5.1 GiB; "),
        (60000, "has more than 2^32 numbers; write it row by row (djpt.render_to_file), render it in parts"),
    ],
)
@pytest.mark.sparse(3)
def test_an_image_that_does_not_fit_is_refused(size: int, message: str) -> None:
    """With 1.5 GiB of addresses."""
    done = subprocess.run([sys.executable, "-c", LIMITED, str(size)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"sensor.film: an image of {size} x {size} pixels with 3 channels {message}")


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_the_same_image_is_written_row_by_row(rfilter: str, tmp_path: Path) -> None:
    """In the same 1.5 GiB of addresses, and with a third of them in memory."""
    script = (
        LIMITED.split("try:")[0]
        + """
description["sensor"]["film"]["rfilter"] = {"type": sys.argv[3]}
djpt.render_to_file(djpt.load_dict(description), sys.argv[2], spp=1)
with open("/proc/self/status") as status:
    print(next(int(line.split()[1]) for line in status if line.startswith("VmHWM")))
"""
    )
    arguments = [sys.executable, "-c", script, "8000", str(tmp_path / "large.exr"), rfilter]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) * 1024 < 0.6 * GIB


@pytest.mark.sparse(6)
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_more_samples_take_no_more_memory(rfilter: str, schedule: str) -> None:
    """At 256 x 256 a pass holds 32 stored samples: 33 spp have all the passes there are."""
    few, many = peaks(33, 129, rfilter=rfilter, schedule=schedule, size=256)
    assert many < few + 0.05 * GIB
    assert many < 0.8 * GIB


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rfilter", "gradient"),
    [("box", False), ("gaussian", False), ("box", True), ("gaussian", True)],
)
def test_large_image(rfilter: str, gradient: bool) -> None:
    """Two spp more than one pass takes, at full size, then twice as many."""
    few, many = peaks(66, 130, rfilter=rfilter, gradient=gradient, type="prb")
    print(f"{rfilter}, gradient {gradient}: {few / GIB:.2f}, {many / GIB:.2f} GiB")
    assert many < few + 0.1 * GIB
    assert many < BUDGET


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["exr", "png", "pfm"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_many_pixels(rfilter: str, suffix: str, tmp_path: Path) -> None:
    """16.8 million pixels, of few samples each, and their file."""
    (peak,) = peaks(2, rfilter=rfilter, size=4096, file=tmp_path / f"large.{suffix}", max_depth=1)
    print(f"{rfilter}, {suffix}: {peak / GIB:.2f} GiB")
    assert peak < BUDGET


@pytest.mark.slow
@pytest.mark.parametrize("schedule", ["auto", "machine"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_many_pixels_of_meshes(rfilter: str, schedule: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if schedule == "machine":
        monkeypatch.setenv("DJPT_RAY_QUERIES", "steps")
    (peak,) = peaks(2, rfilter=rfilter, schedule=schedule, size=4096, mesh=ball_file(tmp_path), max_depth=1)
    print(f"{rfilter}, {schedule}: {peak / GIB:.2f} GiB")
    assert peak < BUDGET


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_all_the_samples(rfilter: str) -> None:
    """The real thing, 2^32 samples of paths of one edge: as many as have numbers."""
    (peak,) = peaks(4096, rfilter=rfilter, max_depth=1)
    print(f"{rfilter}: {peak / GIB:.2f} GiB")
    assert peak < BUDGET


ADAPTIVE = """
import sys
import djpt
description = djpt.cornell_box()
description["sensor"]["film"].update(width=1024, height=1024, rfilter={"type": sys.argv[1]})
description["integrator"] = {"type": "path", "max_depth": 1}
for found in djpt.render_passes(djpt.load_dict(description), spp=6, round_spp=1, adaptive=True):
    pass
found.error(), found.image()
with open("/proc/self/status") as status:
    print(next(int(line.split()[1]) for line in status if line.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_adaptive_rounds(rfilter: str) -> None:
    """Surveys and others; the accumulation of the round before is there while the next one is added up.

    The first process compiles the kernels, for which LLVM takes some memory.
    """
    for budget in (0.55 * GIB, 0.5 * GIB):
        done = subprocess.run([sys.executable, "-c", ADAPTIVE, rfilter], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert int(done.stdout) * 1024 < budget
