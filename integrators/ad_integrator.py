"""Base classes of differentiable integrators that scripts write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import drjit as dr

from djpt.description.properties import Properties
from djpt.dispatch.ensemble import Attached, Detached
from djpt.errors import RenderError
from djpt.films.base import FilmFlags
from djpt.integrators.base import Integrator
from djpt.jit.types import Bool, Color3f, Float, Int32, Point2f, TensorXf, UInt32
from djpt.rendering.gradients.fresh_leaves import attached_view
from djpt.rendering.gradients.leaves import attached_parameters, motion_parameters
from djpt.rendering.gradients.refusals import require_proven
from djpt.rendering.gradients.unproven import moves
from djpt.rendering.schedules.job import require_countable
from djpt.samplers.base import Sampler
from djpt.scene.instance_copies import with_copies
from djpt.scene.scene import Scene, find_sensor
from djpt.sensors.base import Sensor
from djpt.shapes.silhouettes.moving import exchanged
from djpt.shapes.silhouettes.normals import with_normals

__all__ = ["ADIntegrator", "CppADIntegrator", "RBIntegrator", "attached", "modes", "propagate"]

UNBOUNDED = 0xFFFFFFFF
"""The attribute `max_depth` of paths without a longest one."""

BLOCK_SPP = 4
"""Samples per pixel from which on image blocks coalesce."""


class ADIntegrator(Integrator):
    """An integrator that renders a wavefront by itself: all samples of the image at once, one per lane.

    A subclass overrides `sample`. Its derivatives are those of its code, by Dr.Jit's automatic differentiation; loops
    must say how often they run at most (`max_iterations`).

    Parameters: `max_depth` (edges of the longest path; -1, unbounded; default 6), `rr_depth` (default 5),
    `hide_emitters` (default false).
    """

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        depth = props.integer("max_depth", 6, low=-1)
        self.max_depth = UNBOUNDED if depth < 0 else depth
        self.rr_depth = props.integer("rr_depth", 5, low=1)

    def to_string(self) -> str:
        """A line about the settings."""
        return f"{type(self).__name__}[max_depth = {self.max_depth}, rr_depth = {self.rr_depth}]"

    # ---- what subclasses override ------------------------------------------------------

    def sample(  # type: ignore[override]
        self,
        mode: dr.ADMode,
        scene: Scene,
        sampler: Sampler,
        ray: Any,
        depth: UInt32,
        δL: Color3f | None,
        δaovs: Sequence[Float] | None,
        state_in: Any,
        active: Bool,
    ) -> Any:
        """The result of all samples: (radiance, whether each is covered, a list of AOVs, a state).

        Called with keywords, so that a subclass may name the ones that it uses, and take the others by ``**kwargs``.

        Args:
            mode: ``dr.ADMode.Primal``: estimate radiance; ``Forward``: its derivative; ``Backward``: add to the
                gradients of parameters what follows from `δL`.
            scene: The scene.
            sampler: The random numbers of all lanes, seeded.
            ray: A ray with differentials per lane.
            depth: 0.
            δL: The adjoint of the radiance in backward mode, else None.
            δaovs: Those of the AOVs.
            state_in: For `RBIntegrator` alone, the state that a call in primal mode returned, else None.
            active: True.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method sample(mode, scene, sampler, ray, ..)")

    def sample_nested(
        self, scene: Scene, sampler: Any, ray: Any, active: Bool | bool
    ) -> tuple[Color3f, Bool, list[Float]]:
        arguments = {**modes(dr.ADMode.Primal, scene, sampler, ray), "active": Bool(active)}
        color, valid, aovs, _ = self.sample(**arguments, δL=None, δaovs=None, state_in=None)
        return color, valid, aovs

    def prepare(
        self, sensor: Sensor, seed: UInt32 | int = 0, spp: int = 0, aovs: Sequence[str] = ()
    ) -> tuple[Sampler, int]:
        """A seeded copy of the sensor's sampler, and its samples per pixel (0: the sampler's own); prepares the film.

        Raises:
            RenderError: More than 2^32 samples.
        """
        width, height = sampled_grid(sensor)
        require_countable(width, height, spp or sensor.sampler().sample_count())
        sampler = sensor.sampler().begun(seed, spp, width * height)
        sensor.film().prepare(list(aovs))
        return sampler, sampler.sample_count()

    def sample_rays(self, scene: Scene, sensor: Sensor, sampler: Sampler) -> tuple[Any, Color3f, Point2f]:
        """The rays of all samples, their weights, and their positions on the film in pixels.

        The samples of a pixel follow each other, pixels are in rows.
        """
        if (scene.moves or sensor.moves) and not self.follows_motion:
            raise RenderError(
                f"'{type(self).__name__}' renders what moves in slices of time, which only whole images have: use "
                "djpt.render"
            )
        film, spp = sensor.film(), sampler.sample_count()
        width, height = sampled_grid(sensor)
        lane = dr.arange(UInt32, width * height * spp)
        pixel = lane // dr.opaque(UInt32, spp)
        row = pixel // dr.opaque(UInt32, width)
        column = Int32(pixel - row * width)
        border = film.rfilter().border_size() if film.sample_border() else 0
        left, top = (n - border for n in film.crop_offset())
        corner = Point2f(Float(column + left), Float(Int32(row) + top))
        position = corner + sampler.next_2d()
        on_crop = (position - Point2f(film.crop_offset())) * dr.rcp(Point2f(film.crop_size()))
        aperture = sampler.next_2d() if sensor.needs_aperture_sample() else Point2f(0)
        time = Float(sensor.shutter_open())
        if sensor.rolls:
            time = time + dr.clip(position.y / film.size()[1], 0, 1) * sensor.rolling_shutter()
        if sensor.shutter_open_time() > 0:
            time = time + sampler.next_1d() * sensor.shutter_open_time()
        sensor.prepare()
        with dr.resume_grad():
            ray, weight = sensor.attached().sample_ray_differential(time, 0, on_crop, aperture)
        if scene.media:
            ray.medium = scene.replace(sensor=sensor).medium_of_camera(sensor, pixel, on_crop)
        # Without a filter the place on the pixel doesn't matter, and can't be rounded to the next one.
        return ray, weight, corner if film.rfilter().is_box_filter() else position

    # ---- images and derivatives -----------------------------------------------------------

    def render(
        self,
        scene: Scene,
        sensor: Any = 0,
        seed: Any = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> TensorXf:
        """Render an image: see `Integrator.render`."""
        camera = find_sensor(scene, sensor)
        with dr.suspend_grad():
            sampler, spp = self.prepare(camera, seed, spp, self.aov_names())
            ray, weight, position = self.sample_rays(scene, camera, sampler)
            color, valid, aovs, _ = self.sample(
                **modes(dr.ADMode.Primal, scene, sampler, ray), δL=None, δaovs=None, state_in=None
            )
            self.splat(camera, spp, position, color * weight, covered(camera, weight, valid), aovs)
            if not develop:
                return TensorXf()
            image = camera.film().develop()
            if evaluate:
                dr.eval(image)
            return image

    def splat(self, sensor: Sensor, spp: int, position: Point2f, color: Any, valid: Any, aovs: Sequence[Any]) -> None:
        """Add samples to the sensor's film."""
        film = sensor.film()
        block = film.create_block()
        block.set_coalesce(block.coalesce() and spp >= BLOCK_SPP)
        color = Color3f(color)
        alpha = [dr.select(Bool(valid), Float(1), Float(0))] if film.flags() & FilmFlags.Alpha else []
        block.put(position, [color.x, color.y, color.z, *alpha, Float(1), *aovs])
        film.put_block(block)

    def render_forward(self, scene: Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        """The change (H, W, C) of the image that the gradients set on the scene's parameters cause."""
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Forward, camera) as scene, dr.resume_grad():
            image = self._attached_image(scene, camera, seed, spp, dr.ADMode.Forward)
            dr.forward_to(image)
            return dr.grad(image)

    def render_backward(
        self, scene: Scene, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        """Add the gradients that follow from those of the image, `grad_in` (H, W, C), to the scene's parameters."""
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Backward, camera) as scene, dr.resume_grad():
            image = self._attached_image(scene, camera, seed, spp, dr.ADMode.Backward)
            propagate(image, grad_in)
        dr.eval()

    def attached_image(self, scene: Scene, sensor: Any, seed: Any, spp: int) -> TensorXf | None:
        return self._attached_image(scene, sensor, seed, spp, dr.ADMode.Backward)

    def _attached_image(self, scene: Scene, sensor: Any, seed: Any, spp: int, mode: dr.ADMode) -> TensorXf:
        """The image as the code of `sample` computes it, attached to what the view `scene` reads."""
        camera = find_sensor(scene, sensor)
        with dr.suspend_grad():
            sampler, spp = self.prepare(camera, seed, spp, self.aov_names())
            ray, weight, position = self.sample_rays(scene, camera, sampler)
            with dr.resume_grad():
                color, valid, aovs, _ = self.sample(
                    **modes(mode, scene, sampler, ray), δL=None, δaovs=None, state_in=None
                )
                self.splat(camera, spp, position, color * weight, covered(camera, weight, valid), aovs)
                return camera.film().develop()


def covered(sensor: Sensor, weight: Color3f, valid: Any) -> Any:
    """Whether samples count as covered: not where the lens shows nothing, see `Sensor.has_image_circle`."""
    return Bool(valid) & (weight.x > 0) if sensor.has_image_circle else valid


CppADIntegrator = ADIntegrator
"""Mitsuba's name of the base, which is written in C++ there."""


class RBIntegrator(ADIntegrator):
    """An integrator that propagates derivatives of radiance in a second run of its own, without a graph of the first.

    `sample` runs in primal mode, and then, with the same random numbers and the state that it returned, in forward or
    backward mode: in forward mode it returns derivatives in place of radiance, in backward mode it calls `dr.backward`
    itself.
    """

    def render_forward(self, scene: Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Forward, camera) as scene, dr.suspend_grad():
            spread_changes(scene)
            sampler, spp = self.prepare(camera, seed, spp, self.aov_names())
            ray, weight, position = self.sample_rays(scene, camera, sampler)
            state = self._primal_state(scene, sampler, ray)
            change, valid, changes, _ = self.sample(
                **modes(dr.ADMode.Forward, scene, sampler, ray), δL=None, δaovs=None, state_in=state
            )
            covers = covered(camera, weight, valid)
            self.splat(camera, spp, position, change * weight, covers, [c * weight.x for c in changes])
            return camera.film().develop()

    def render_backward(
        self, scene: Scene, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Backward, camera) as scene, dr.suspend_grad():
            sampler, spp = self.prepare(camera, seed, spp, self.aov_names())
            ray, weight, position = self.sample_rays(scene, camera, sampler)
            with dr.resume_grad():
                lanes = sampler.wavefront_size()
                color = dr.full(Color3f, 1, lanes)
                aovs = [dr.full(Float, 1, lanes) for _ in self.aov_names()]
                dr.enable_grad(color, aovs)
                self.splat(camera, spp, position, color * weight, Bool(True), [aov * weight.x for aov in aovs])
                propagate(camera.film().develop(), grad_in)
                adjoint, adjoints = dr.grad(color), dr.grad(aovs)
            camera.film().clear()
            state = self._primal_state(scene, sampler, ray)
            self.sample(**modes(dr.ADMode.Backward, scene, sampler, ray), δL=adjoint, δaovs=adjoints, state_in=state)
            dr.eval()  # `sample` writes to the gradients

    def attached_image(self, scene: Scene, sensor: Any, seed: Any, spp: int) -> TensorXf | None:
        return None

    def _primal_state(self, scene: Scene, sampler: Sampler, ray: Any) -> Any:
        """The state that the primal run leaves; the sampler stays where it is."""
        mode = modes(dr.ADMode.Primal, scene, sampler.clone(), ray)
        return self.sample(**mode, δL=None, δaovs=None, state_in=None)[3]


def modes(mode: dr.ADMode, scene: Scene, sampler: Sampler, ray: Any) -> dict[str, Any]:
    """The arguments of `sample` that all calls have."""
    return {
        "mode": mode,
        "scene": scene,
        "sampler": sampler,
        "ray": ray,
        "depth": UInt32(0),
        "active": Bool(True),
    }


def sampled_grid(sensor: Sensor) -> tuple[int, int]:
    """Columns and rows of the pixels that are sampled: the crop window, with the border of `sample_border`."""
    film = sensor.film()
    border = film.rfilter().border_size() if film.sample_border() else 0
    width, height = (n + 2 * border for n in film.crop_size())
    return width, height


@contextmanager
def attached(integrator: Integrator, scene: Scene, mode: dr.ADMode, sensor: Sensor | None = None) -> Iterator[Scene]:
    """The scene as it is, if it reads AD variables already; else a view that reads those of its parameters.

    It does so within a `with` block: shapes move by the same variables as long.

    They are copies, so that their graph is the view's own, whatever clears it: in forward mode with the same gradients;
    in backward mode, those that they have at the end are propagated to the parameters.

    Raises:
        RenderError: the derivatives of images by the integrator are known to be wrong
        (`djpt.rendering.gradients.unproven`).
    """
    if not isinstance(scene.lookup, Detached):
        yield scene
        return
    if moves(scene, sensor):
        scene = with_copies(scene)
    require_proven(scene, integrator, sensor)
    parameters = [*attached_parameters(scene), *motion_parameters(scene, sensor)]
    forward = mode == dr.ADMode.Forward
    with dr.resume_grad():
        changes = [dr.forward_to(p.value, flags=dr.ADFlag.ClearNone) for p in parameters] if forward else []
        leaves = [type(p.value)(dr.detach(p.value)) for p in parameters]
        # Numbers that were written into a script must not be written into kernels, nor must a change of 0.
        dr.make_opaque(leaves, changes)
        dr.enable_grad(leaves)
        if forward:
            dr.set_grad(leaves, changes)
    places = {(id(p.owner), p.attribute): leaf for p, leaf in zip(parameters, leaves, strict=True)}
    with exchanged(with_normals(places, scene.shapes())):
        yield attached_view(scene, places)
    if not forward:
        with dr.resume_grad():
            for parameter, leaf in zip(parameters, leaves, strict=True):
                dr.accum_grad(parameter.value, dr.grad(leaf))
                dr.enqueue(dr.ADMode.Backward, parameter.value)
            dr.traverse(dr.ADMode.Backward)


def spread_changes(scene: Scene) -> None:
    """Propagate the gradients of the parameters to the tables that kernels read: loops can't do it themselves."""
    lookup = scene.lookup
    if isinstance(lookup, Attached):
        with dr.resume_grad():
            dr.enqueue(dr.ADMode.Forward, lookup.variables())
            dr.traverse(dr.ADMode.Forward, dr.ADFlag.ClearEdges)


def propagate(image: TensorXf, grad: TensorXf) -> None:
    """Propagate the gradients `grad` of an image to what it was computed from."""
    dr.set_grad(image, grad)
    dr.enqueue(dr.ADMode.Backward, image)
    dr.traverse(dr.ADMode.Backward)
