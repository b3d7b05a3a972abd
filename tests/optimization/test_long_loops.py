"""A thousand steps with scenes that are loaded and edited: no memory, no kernels, and no time that they didn't take."""

import json

import pytest

from tests.kit.processes import run_python

pytestmark = pytest.mark.slow

STEPS = """
import json, time
import djpt
import drjit as dr

description = djpt.cornell_box()
description["sensor"]["film"].update(width=16, height=16)
key = "red.reflectance.value"
scene, found = djpt.load_dict(description), []


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096



def hashes():
    return {kernel["hash"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT}


for step in range(1201):
    if %r:
        scene = djpt.load_dict(description)
    params = djpt.traverse(scene)
    value = djpt.Color3f(0.3 + 0.0004 * step)
    dr.enable_grad(value)
    params[key] = value
    params.update()
    image = djpt.render(scene, params, spp=1, seed=step)
    dr.backward(dr.mean(dr.square(image), axis=None))
    dr.eval(dr.grad(value))
    dr.sync_thread()
    if step %% 200 == 199:
        found.append([time.process_time(), resident()])
    # Histories of kernels take memory, so there are two of one step each, the second after all was measured.
    dr.set_flag(dr.JitFlag.KernelHistory, step in (98, 1199))
    if step == 99:
        known = hashes()
print(json.dumps([found, len(hashes() - known)]))
"""


@pytest.mark.parametrize("loads", [False, True])
def test_memory_kernels_and_time_stay(loads: bool) -> None:
    run = run_python("-c", STEPS % loads, timeout=600)
    assert run.returncode == 0, run.stderr
    found, compiled = json.loads(run.stdout.splitlines()[-1])
    times, memory = zip(*found, strict=True)
    # 10 MiB in 10,000 steps.
    assert memory[-1] - memory[0] < 2**20
    assert compiled == 0
    assert times[-1] - times[-2] < 1.5 * (times[2] - times[1])
