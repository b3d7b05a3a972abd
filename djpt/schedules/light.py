"""The light schedule: a lane follows one light path after the other and adds to any pixel.

Floating-point sums depend on the order of additions, and threads add in any order. Sums of whole numbers don't. So
contributions are scaled and rounded to 64-bit numbers: an image is the same, bit for bit, for any number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from djpt.integrators.ptracer import LightPath, ParticleTracer
from djpt.kernels import as_float, wide
from djpt.schedules.job import Job
from djpt.schedules.passes import picture, ranges, report
from djpt.types import Array4i64, Bool, Color3f, Float, Float64, Int64, Point2f, TensorXf, UInt32

__all__ = ["splat_image"]

LANES = 2**16

PASS_PATHS = 2**24
"""Light paths of one kernel launch: about a second on two cores."""

DIGITS = 32
"""Binary digits behind the point, in units of `brightness`: as many are left before it, less one."""


@dataclass
class Lane:
    """Loop state."""

    path: LightPath
    sampler: Any
    number: UInt32
    """Of the path, among those of the pass."""


class Splats:
    """Per pixel of the crop window the sums of three channels, as whole numbers."""

    def __init__(self, job: Job, brightness: float) -> None:
        self._job = job
        width, height = job.film.crop_size
        self._size = Point2f(as_float(width), as_float(height))
        self._columns, self._rows = dr.opaque(UInt32, width), dr.opaque(UInt32, height)
        self._scale = as_float(2.0**DIGITS / brightness)
        # One number in four is only there to make a packet.
        self.memory = dr.zeros(Int64, 4 * width * height)
        dr.eval(self.memory)

    def add(self, position: Point2f, color: Color3f, active: Bool) -> None:
        """Add a colour, weighted with the film's filter, whose weights are made to sum up to 1."""
        x, y = position.x * self._size.x, position.y * self._size.y
        column, row = UInt32(x), UInt32(y)
        color = color * self._scale
        film = self._job.film
        if not film.filters:
            self._add(row * self._columns + column, color, active)
            return
        reach, weight = film.taps // 2, film.rfilter.eval
        # Before the first column and row the numbers wrap around to large ones.
        column, row, steps = column - reach, row - reach, range(2 * reach + 1)
        in_x = [weight(x - dr.floor(x) + (reach - i - 0.5)) for i in steps]
        in_y = [weight(y - dr.floor(y) + (reach - j - 0.5)) for j in steps]
        color = color * dr.rcp(sum(in_x[1:], in_x[0]) * sum(in_y[1:], in_y[0]))
        for j, wy in zip(steps, in_y, strict=True):
            for i, wx in zip(steps, in_x, strict=True):
                inside = (column + i < self._columns) & (row + j < self._rows)
                self._add((row + j) * self._columns + (column + i), color * (wx * wy), active & inside)

    def _add(self, pixel: UInt32, color: Color3f, active: Bool) -> None:
        whole = [Int64(dr.round(c)) for c in color]
        dr.scatter_add(self.memory, Array4i64(*whole, Int64(0)), pixel, active)

    def sums(self) -> list[Float]:
        """The three channels, pixel by pixel."""
        pixel = dr.arange(UInt32, dr.width(self.memory) // 4)
        inverse = Float64(1) / Float64(self._scale)
        return [Float(Float64(dr.gather(Int64, self.memory, 4 * pixel + c)) * inverse) for c in range(3)]


def splat_image(job: Job) -> TensorXf:
    """What light paths bring to the film: `spp` paths for every pixel of the crop window."""
    splats = Splats(job, brightness(job))
    width, height = job.film.crop_size
    per_pass = max(1, PASS_PATHS // (width * height))
    for begin, end in ranges(job.spp, per_pass):
        trace(job, splats, begin * width * height, end * width * height)
        report(job, end * width * height)
    inverse = dr.rcp(dr.opaque(Float, job.spp))
    channels = [channel * inverse for channel in job.channels(Color3f(*splats.sums()), Bool(False), [])]
    dr.eval(channels)
    return picture(channels, width, height)


def brightness(job: Job) -> float:
    """The radiance of a surface that sees the lights from afar, roughly: a power of two.

    The light of all emitters, spread over a sphere about the scene.
    """
    low, high = job.scene.bbox()
    radius = max(float(np.linalg.norm(np.array(high) - np.array(low))) / 2, 1e-6)
    radiance = sum(e.power() for e in job.scene.emitters()) / (math.pi * 4 * math.pi * radius**2)
    return 2.0 ** round(math.log2(radiance)) if radiance > 0 else 1.0


def trace(job: Job, splats: Splats, begin: int, end: int) -> None:
    """Add the light paths begin <= number < end."""
    integrator, scene, camera = job.integrator, job.scene, job.camera
    assert isinstance(integrator, ParticleTracer)
    lanes = min(LANES, end - begin)
    first, stop, stride = dr.opaque(UInt32, begin), dr.opaque(UInt32, end), dr.opaque(UInt32, lanes)

    def fresh(number: UInt32) -> tuple[Any, LightPath]:
        sampler = job.stream(number // job.spp_value, number % job.spp_value)
        return sampler, integrator.begin(scene, sampler)

    number = dr.arange(UInt32, lanes) + first
    sampler, path = fresh(number)
    start = Lane(wide(path, lanes), sampler, number)

    def body(lane: Lane) -> tuple[Lane]:
        si = scene.surface_interaction(lane.path.ray, scene.closest_hit(lane.path.ray), full=scene.needs_uv)
        v = integrator.vertex(scene, camera, lane.sampler, lane.path, si)
        arrives = (dr.max(v.splat) > 0) & integrator.reaches_camera(scene, v.shadow_ray)
        splats.add(v.position, v.splat, arrives)

        number = dr.select(v.active, lane.number, lane.number + stride)
        sampler, path = fresh(number)
        return (Lane(dr.select(v.active, v.path, path), dr.select(v.active, lane.sampler, sampler), number),)

    (done,) = dr.while_loop((start,), lambda lane: lane.number < stop, body, label="light")
    dr.eval(done.number, splats.memory)
