"""The choice of the schedule that renders an image."""

from __future__ import annotations

import functools

from djpt.errors import RenderError, near_miss
from djpt.rendering import schedules
from djpt.rendering.schedules.base import Schedule
from djpt.rendering.schedules.called_sums import holds_sums
from djpt.rendering.schedules.job import Job

__all__ = ["choose"]

SCHEDULES = {
    "machine": "Machine",
    "media_machine": "MediaMachine",
    "flat": "Flat",
    "learning": "Learning",
    "progressive": "Progressive",
    "splatting": "Splatting",
    "photons": "Photons",
    "wave": "Wave",
}
"""The schedules by name, with their classes; the fastest first."""
FOR_LANES = {"wavefront": "Wavefront"}
"""The one for samplers that are nothing but a stream of lanes."""
NAMES = ("auto", "flat", "machine", "wave")


def choose(name: str, job: Job) -> Schedule:
    """The schedule with a name, or for `auto` the fastest that is possible.

    An integrator that can't run in `wave`, because it starts at the lights, gets the schedule that it can run in.

    Raises:
        RenderError: There is none of that name, or it can't run the job's integrator on the job's scene.
    """
    if not isinstance(name, str) or name not in NAMES:
        raise RenderError(f"unknown schedule '{name}'{near_miss(str(name), NAMES)}")
    if not job.sampler.has_streams:
        require_lanes(name, job)
        return schedule("wavefront")
    possible, has_tree = job.integrator.schedules, job.scene.geometry.has_trees
    if name == "machine" and job.scene.geometry.overlaps:
        raise RenderError("the schedule 'machine' doesn't follow bodies that overlap: use 'flat'")
    if name == "machine" and "media_machine" in possible:
        return schedule("media_machine")
    if name in ("flat", "machine") and name not in possible:
        raise RenderError(
            f"the integrator '{type(job.integrator).__name__}' doesn't advance vertex by vertex: use schedule='wave'"
        )
    if name == "machine" and job.scene.geometry.moves:
        raise RenderError(
            "the schedule 'machine' searches one BVH, but shapes that move have each their own: use 'flat'"
        )
    if name == "machine" and not has_tree:
        raise RenderError("the schedule 'machine' searches a BVH, but the scene has no meshes: use schedule='flat'")
    if name in possible:
        return schedule(name)
    return schedule(next(n for n in SCHEDULES if n in possible and pays(n, job)))


def pays(name: str, job: Job) -> bool:
    """Whether a schedule that can run a job is worth while: state machines are if lanes would wait for each other.

    A search that is one call leaves no lane waiting for another, nor does a flight with a closed form. The many
    channels of an integrator that nests another are stored faster sample by sample, if they must be.
    """
    if name == "flat" and job.integrator.path_tracer is not job.integrator:
        return holds_sums(job)
    if name == "machine":
        return job.scene.geometry.stepwise
    tracks = any(medium.is_tracked for medium in job.scene.media.plugins) and not job.scene.geometry.overlaps
    return name != "media_machine" or tracks


def require_lanes(name: str, job: Job) -> None:
    """Raise `RenderError` unless a job can be done with one lane per sample, and nothing else was asked for."""
    sampler = f"the sampler '{type(job.sampler).__name__}' has next_1d and next_2d, but no 'stream' for each sample"
    if name in ("flat", "machine"):
        raise RenderError(f"{sampler}: use schedule='wave'")
    if "wave" not in job.integrator.schedules:
        raise RenderError(f"{sampler}, which '{type(job.integrator).__name__}' needs: use another integrator")


@functools.cache
def schedule(name: str) -> Schedule:
    """The schedule of a name; imported when it is first used."""
    made: Schedule = getattr(schedules, (SCHEDULES | FOR_LANES)[name])()
    return made
