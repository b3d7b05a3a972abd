"""The choice of the schedule that renders an image."""

from __future__ import annotations

from djpt.errors import RenderError, near_miss
from djpt.schedules.base import Schedule
from djpt.schedules.flat import Flat
from djpt.schedules.job import Job
from djpt.schedules.machine import Machine
from djpt.schedules.progressive import Progressive
from djpt.schedules.wave import Wave

__all__ = ["choose"]

SCHEDULES: dict[str, Schedule] = {
    schedule.name: schedule for schedule in (Machine(), Flat(), Progressive(), Wave())
}  # the fastest first
NAMES = ("auto", "flat", "machine", "wave")


def choose(name: str, job: Job) -> Schedule:
    """The schedule with a name, or for `auto` the fastest that is possible.

    An integrator that can't run in `wave`, because it starts at the lights, gets the schedule that it can run in.

    Raises:
        RenderError: There is none of that name, or it can't run the job's integrator on the job's scene.
    """
    if name not in NAMES:
        raise RenderError(f"unknown schedule '{name}'{near_miss(str(name), NAMES)}")
    possible, has_tree = job.integrator.schedules, job.scene.geometry.triangles is not None
    if name in ("flat", "machine") and name not in possible:
        raise RenderError(
            f"the integrator '{type(job.integrator).__name__}' doesn't advance vertex by vertex: use schedule='wave'"
        )
    if name == "machine" and not has_tree:
        raise RenderError("the schedule 'machine' walks a BVH, and the scene has no meshes: use schedule='flat'")
    if name in possible:
        return SCHEDULES[name]
    # A search that is one call leaves no lane waiting for another: lanes needn't be state machines.
    stepwise = job.scene.geometry.stepwise
    return next(s for n, s in SCHEDULES.items() if n in possible and (stepwise or n != "machine"))
