"""Replay of bidirectional paths: gradients with the memory of a picture.

In reverse mode each sample has four walks, all by the same random numbers: along the light path and along the camera
path, to add up what each finds times the adjoints of the pixels that it lights; then again along the camera path and
along the light path, to differentiate, at each vertex, the factors of the light that is found behind it. A connection
is differentiated by the second camera walk. In forward mode there are two walks, which carry changes along.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr

from djpt.core.records import Ray3f
from djpt.integrators.bdpt import JOINED, BidirectionalPath
from djpt.integrators.bidirectional.subpath import vertices
from djpt.jit.kernels import loop_traced_once, while_loop, wide
from djpt.jit.types import Bool, Color3f, Float, UInt32
from djpt.rendering.gradients.gradient_sums import (
    Carried,
    Forward,
    Found,
    GradientSums,
    Joined,
    Joint,
    Measure,
    Reverse,
    added,
)
from djpt.rendering.gradients.light_replay import Joints, LightWalk, Step, begun, nothing, vanishes, walk_light_paths
from djpt.samplers.base import SampleStream
from djpt.scene.scene import Scene
from djpt.sensors.base import Sensor

__all__ = ["BothEnds"]


@dataclass
class CameraWalk:
    """Loop state. Types are `Any` where Dr.Jit would look for their names in this module."""

    subpath: Any
    """The `End` of the path."""
    sampler: Any
    active: Bool
    covered: Bool
    carried: Any
    """What is `Carried`."""
    joined: Any
    """What connections have found so far: `Joined`. Its change is that of the whole sample."""
    joints: Any
    """`Joints`."""


class BothEnds:
    """The samples of `bdpt`, one per lane, differentiated."""

    def __init__(
        self, integrator: BidirectionalPath, scene: Scene, camera: Sensor, ray: Ray3f, inside: Bool, lanes: int
    ) -> None:
        """`scene` is a view whose lookups are attached; `inside` says whose camera ray is in the crop window."""
        self._integrator, self._scene, self._camera = integrator, scene, camera
        self._ray, self._inside, self._lanes = ray, inside, lanes
        self._power = Float(0)

    def reverse(self, measure: Measure, again: Reverse, sampler: SampleStream, delta: Color3f) -> None:
        """Propagate gradients to what the scene reads; `delta` is the derivative of the loss by each sample."""
        first = sampler.clone()
        light = self._light_walk(measure, sampler, self._nothing(), self._room())
        middle = light.sampler.clone()
        camera = self._camera_walk(measure, light.sampler, self._nothing(), delta, light)
        found, joined, light.joints = light.carried, camera.joined, camera.joints
        camera = self._camera_walk(again, middle, camera.carried, delta, light)
        found = Carried(found.light + joined.light, added(found.behind, None, joined.behind_other))
        self._light_walk(again, first, found, camera.joints)

    def forward(self, gradient_sums: Forward, sampler: SampleStream) -> Color3f:
        """The derivative of each sample, by gradients of what the scene reads; adds those of light shown elsewhere."""
        light = self._light_walk(gradient_sums, sampler, self._nothing(), self._room())
        camera = self._camera_walk(gradient_sums, light.sampler, self._nothing(), Color3f(0), light)
        change: Color3f = camera.joined.change
        return change

    def _nothing(self) -> Carried:
        return nothing(self._scene, self._lanes)

    def _unjoined(self) -> Joined:
        """What no connections have found."""
        black, empty = dr.zeros(Color3f, self._lanes), self._nothing()
        return Joined(empty.light, empty.behind, empty.behind, black)

    def _room(self) -> Joints:
        zero_weight = dr.alloc_local(Color3f, JOINED) if vanishes(self._scene) else None
        return Joints(vertices(self._scene, JOINED), dr.alloc_local(Color3f, JOINED), zero_weight)

    # ---- light paths -------------------------------------------------------------------

    def begin(self, sampler: SampleStream) -> tuple[Any, Color3f, Color3f | None]:
        """See `LightPaths`."""
        subpath, power = self._integrator.at_light(self._scene, sampler)
        self._power = dr.detach(power)
        throughput, zero_weight = begun(self._scene, subpath.throughput, subpath.throughput)
        return replace(subpath, throughput=throughput, zero_weight=zero_weight), throughput, zero_weight

    def step(self, state: Any, sampler: SampleStream, active: Bool) -> Step:
        """See `LightPaths`."""
        hit = self._integrator.light_hit(self._scene, state, self._power, sampler, active)
        found = self._integrator.light_step(self._scene, self._camera, hit, sampler)
        return Step(
            arrived=hit.subpath.throughput,
            position=found.position,
            light=Color3f(0) if found.shown is None else found.shown * dr.detach(found.weight),
            shows=Bool(False) if found.shown is None else self._inside & hit.joins,
            onward=found.subpath.throughput,
            zero_weight=found.subpath.zero_weight,
            state=found.subpath,
            active=found.active,
            joins=hit.joins,
            vertex=dr.detach(hit.light_vertex),
        )

    def _light_walk(
        self, gradient_sums: GradientSums, sampler: SampleStream, carried: Carried, joints: Joints
    ) -> LightWalk:
        begins = self._integrator.starts_light_paths
        return walk_light_paths(self, gradient_sums, sampler, self._lanes, carried, begins, joints)

    # ---- camera paths ------------------------------------------------------------------

    def _camera_walk(
        self, gradient_sums: GradientSums, sampler: SampleStream, carried: Carried, delta: Color3f, light: LightWalk
    ) -> CameraWalk:
        """Follow camera paths, and connect them to the vertices of the light paths that were followed before."""
        integrator, scene = self._integrator, self._scene
        subpath = integrator.at_camera(scene, self._camera, self._ray, self._inside)
        subpath.zero_weight = Color3f(1) if vanishes(scene) else None
        start = CameraWalk(
            subpath=wide(subpath, self._lanes),
            sampler=sampler,
            active=dr.full(Bool, integrator.max_depth != 0, self._lanes),
            covered=dr.full(Bool, False, self._lanes),
            carried=carried,
            joined=self._unjoined(),
            joints=light.joints,
        )

        def body(lane: CameraWalk) -> tuple[CameraWalk]:
            with dr.resume_grad():
                hit = integrator.camera_hit(
                    scene, lane.subpath, self._ray.maxt, lane.covered, lane.sampler, lane.active
                )
                step = integrator.camera_step(scene, hit, lane.sampler)
            arrived = dr.detach(hit.subpath)
            count = dr.select(hit.joins, light.count, 0)

            def connect(i: UInt32, joined: Joined, joints: Joints) -> tuple[UInt32, Joined, Joints]:
                v = joints.vertices.read(i)
                there = None if joints.zero_weight is None else joints.zero_weight.read(i)
                with dr.resume_grad():
                    to, value, weight = integrator.connection(scene, arrived, hit.vertex, v)
                    lit = Bool(True) if dr.grad_enabled(value) else None
                    value = scene.transmittance(hit.vertex.ray_to(to), value, lit, to_emitter=False)
                    joint = Joint(value * dr.detach(weight), delta, arrived.zero_weight, there, joints.beside, i)
                    joined = gradient_sums.connect(joined, joint)
                return i + 1, joined, joints

            _, joined, lane.joints = while_loop(
                (dr.zeros(UInt32, self._lanes), self._unjoined(), lane.joints),
                lambda i, joined, joints: i < count,
                connect,
                label=f"connections, {gradient_sums.label}",
            )
            with dr.resume_grad():
                subpath, active = integrator.after(scene, hit, step, lane.sampler)
                found = Found(
                    light=hit.met * dr.detach(hit.weight) + step.lit * dr.detach(step.weight),
                    adjoint=delta,
                    arrived=hit.subpath.throughput,
                    joined=joined,
                    onward=subpath.throughput,
                    active=active,
                    before=arrived.zero_weight,
                    after=subpath.zero_weight,
                )
                lane.carried, _, joined.change = gradient_sums.visit(lane.carried, found)
            lane.joined = both(lane.joined, joined)
            lane.covered |= step.covers
            lane.subpath, lane.active = dr.detach(subpath), active
            return (lane,)

        (walked,) = loop_traced_once(start, lambda lane: lane.active, body, f"camera path, {gradient_sums.label}")
        return walked


def both(a: Joined, b: Joined) -> Joined:
    """What two sets of connections find."""
    return Joined(
        light=a.light + b.light,
        behind=added(a.behind, None, b.behind),
        behind_other=added(a.behind_other, None, b.behind_other),
        change=a.change + b.change,
    )
