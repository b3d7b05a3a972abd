"""Scenes load and render whatever the flags of Dr.Jit say."""

from __future__ import annotations

import pytest

from tests.kit.processes import ROOT, run_python

INTERNAL = {"Default", "EnableObjectTraversal", "FreezingScope", "SymbolicScope"}
"""Not a flag, and states of Dr.Jit that it sets itself: a caller who does breaks Dr.Jit without djpt, too."""

FLAGS = [
    "CompressLoops",
    "ConstantPropagation",
    "Debug",
    "FastMath",
    "ForbidSynchronization",
    "ForceOptiX",
    "KernelFreezing",
    "KernelHistory",
    "LaunchBlocking",
    "MergeFunctions",
    "OptimizeCalls",
    "OptimizeLoops",
    "PacketOps",
    "PrintIR",
    "ReuseIndices",
    "ScatterReduceLocal",
    "ShaderExecutionReordering",
    "SpillToSharedMemory",
    "SymbolicCalls",
    "SymbolicConditionals",
    "SymbolicLoops",
    "ValueNumbering",
]

PROGRAM = """
import sys
import djpt
import drjit as dr, numpy as np
from tests.kit.renders import box
from tests.freezing.test_rendering import with_mesh
flag, RED = getattr(dr.JitFlag, sys.argv[1]), "red.reflectance.value"

def pictures():
    for edit in (None, with_mesh):
        scene = djpt.load_dict(box(4, "gaussian", edit=edit))
        params = djpt.traverse(scene)
        dr.enable_grad(params[RED])
        params.update()
        image = djpt.render(scene, params, spp=2)
        dr.backward(dr.sum(image, axis=None))
        yield dr.detach(image)
        yield dr.grad(params[RED])

usual = list(pictures())
with dr.scoped_set_flag(flag, not dr.flag(flag)):
    other = list(pictures())
    dr.eval(other)
print(all(np.allclose(np.array(a), np.array(b), rtol=1e-4, atol=1e-5) for a, b in zip(usual, other, strict=True)))
"""


def check(flag: str, rays: str = "auto") -> None:
    program = f"import os; os.environ['DJPT_RAY_QUERIES'] = {rays!r}\n{PROGRAM}"
    done = run_python("-c", program, flag, cwd=ROOT)
    assert done.returncode == 0, f"{flag}: {done.stderr[-2000:]}"
    assert done.stdout.strip().endswith("True"), f"{flag}: other values: {done.stdout[-500:]}"


def test_all_flags_are_tested() -> None:
    import drjit as dr

    names = {name for name in dir(dr.JitFlag) if name[0].isupper()}
    assert names == {*FLAGS, *INTERNAL}


@pytest.mark.parametrize("flag", ["SymbolicLoops", "ForbidSynchronization"])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_a_flag_that_concerns_loops_or_loading_aborts_nothing(flag: str) -> None:
    check(flag)


@pytest.mark.slow
@pytest.mark.parametrize("rays", ["auto", "steps"])
@pytest.mark.parametrize("flag", FLAGS)
def test_no_flag_aborts(flag: str, rays: str) -> None:
    check(flag, rays)
