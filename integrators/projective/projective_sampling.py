"""The base of integrators that sample silhouettes for derivatives with respect to geometry."""

from __future__ import annotations

import copy
from typing import Any

import drjit as dr

from djpt.core.records import (
    DirectionSample3f,
    Interaction3f,
    Ray3f,
    RayFlags,
    SurfaceInteraction3f,
)
from djpt.description.properties import Properties
from djpt.dispatch.ensemble import Attached
from djpt.films.moving_samples import moving_samples
from djpt.integrators.ad_integrator import RBIntegrator, attached, modes, propagate
from djpt.integrators.projective.beams import BeamSides, has_sides
from djpt.integrators.projective.camera_apart import camera_apart
from djpt.integrators.projective.circles import edge_of_circle
from djpt.integrators.projective.detail import ProjectiveDetail, has_strips
from djpt.integrators.projective.film_edges import FilmEdges
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.path_edges import path_edges
from djpt.integrators.projective.reattach import delta_lights, has_mirrors
from djpt.integrators.projective.receivers import followed, only_lamps_shine, outlined, shadowed_lamps
from djpt.integrators.projective.self_views import Approach, with_bodies
from djpt.integrators.projective.shadows import LampShadows, ShadowEdges
from djpt.integrators.projective.smooth_chains import Chains
from djpt.integrators.projective.spread import lens_points, spread
from djpt.integrators.projective.strips import beside_outline
from djpt.integrators.projective.wedges import clear_of_wedges, close_together
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, TensorXf, UInt32, Vector3f
from djpt.rendering.gradients.fresh_leaves import attached_view
from djpt.rendering.gradients.meetings import meeting_pairs
from djpt.rendering.gradients.unproven import moves
from djpt.samplers.base import Sampler
from djpt.scene.scene import Scene, find_sensor
from djpt.sensors.base import Sensor
from djpt.shapes.silhouettes.foreground import foreground, nothing_at, toward_viewer
from djpt.shapes.silhouettes.samples import SilhouetteSample3f
from djpt.textures.patches import Patches, have_patches

__all__ = ["PSIntegrator"]

PRIMARY_SEED, GUIDING_SEED, INDIRECT_SEED = 0xFFFFFFFF, 0xAFAFAFAF, 0xAA00AA00
SHADOW_SEED, CUT_SEED, LENS_SEED, CIRCLE_SEED = 0x77777777, 0x33333333, 0x55555555, 0x99999999
LINE_SEED, PATH_SEED, LAMP_SEED = 0xCCCCCCCC, 0x66666666, 0xDDDDDDDD
"""Combined with the seed of the image, for samples of their own."""
CLOSE_TO_SURFACE = 1 / 16
"""How far off a surface rays to the sensor begin, in the distance at which other ones do."""


class PSIntegrator(RBIntegrator):
    """An integrator whose derivative is a sum of three estimates: within surfaces, at silhouettes, behind silhouettes.

    The first is that of `RBIntegrator`, or, if the class clears `radiative_backprop`, of `ADIntegrator`. The second
    comes from silhouettes as the camera sees them, the third from those that other surfaces see, which shadows and
    reflections show: see `djpt.ad.projective`. A subclass overrides `sample`, `sample_radiance_difference`
    or `sample_radiances`, and `sample_importance`.

    Parameters: those of `ADIntegrator`; `sppc`, `sppp`, `sppi`: the samples per pixel of the three estimates, unless
    the call sets them (default: the sampler's; 0: none, whatever the call sets); `guiding`: how samples of the third
    are guided, by an `octree`, a `grid`, not at all (`none`), or by an octree where that pays (`auto`, the default):
    if samples are many, or 16,384 random silhouettes show that few of them matter; `guiding_proj` (default true):
    whether the guide learns from projected paths or from uniform samples; `guiding_rounds` (default 1).

    More settings are attributes: `proj_seed_spp`, samples per pixel that are projected; `guiding_grid_reso`,
    `octree_max_depth`, `octree_max_leaf_cnt`, `octree_extra_leaf_sample`, `octree_highres_x_slices`,
    `octree_contruction_thres`, `octree_construction_mean_mult`, `clamp_mass_thres`, `scale_mass`: see
    `djpt.ad.guiding`, and for their defaults docs/performance.md; `proj_mesh_algo` (`hybrid`, `walk` or `jump`),
    `proj_mesh_max_walk`, `proj_mesh_max_jump`.
    """

    follows_silhouettes = True
    follows_motion = False
    direct_light_only = False
    """True if surfaces are lit by emitters alone."""
    radiative_backprop = True
    """True if the derivative within surfaces is computed in a second run of `sample`."""

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.sppc, self.sppp, self.sppi = (optional(props, name) for name in ("sppc", "sppp", "sppi"))
        self.guiding = props.string("guiding", "auto", choices=("auto", "none", "grid", "octree"))
        self.guiding_proj = props.boolean("guiding_proj", True)
        self.guiding_rounds = props.integer("guiding_rounds", 1, low=1)
        self.guiding_grid_reso = [10000, 100, 100]
        self.proj_seed_spp = 64
        self.clamp_mass_thres = 1e-8
        self.scale_mass = 0.0
        self.proj_mesh_algo = "hybrid"
        self.proj_mesh_max_walk = 30
        self.proj_mesh_max_jump = 2
        self.octree_max_depth = 8
        self.octree_max_leaf_cnt = 2**24
        self.octree_extra_leaf_sample = 8
        self.octree_highres_x_slices = 100
        self.octree_contruction_thres = 0.0
        self.octree_construction_mean_mult = 0.1
        self.octree_scatter_inc = True
        self.proj_detail = ProjectiveDetail(self)

    # ---- what subclasses override ------------------------------------------------------

    def sample(  # type: ignore[override]
        self,
        mode: dr.ADMode,
        scene: Scene,
        sampler: Sampler,
        ray: Any,
        depth: Any,
        δL: Any,
        δaovs: Any,
        state_in: Any,
        active: Any,
        project: bool = False,
        si_shade: Any = None,
        horizon: Any = None,
    ) -> Any:
        """The result of all samples: see `ADIntegrator.sample`.

        More keywords may be given. With `project` true, the fourth result is (rays, mask): one ray per path that hits
        a surface, to be projected onto silhouettes. If `si_shade` is given, the path starts at these surface points,
        whatever `ray` is; light of points, and parallel light, doesn't arrive there if it makes a negative scalar
        product with vectors `horizon`.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method sample(mode, scene, sampler, ray, ..)")

    def sample_radiance_difference(
        self,
        scene: Scene,
        ss: SilhouetteSample3f,
        curr_depth: Any,
        sampler: Sampler,
        wavelengths: Any,
        active: Bool | bool,
    ) -> tuple[Color3f, Bool]:
        """The radiance of the surface at silhouettes less that of what is behind, along -`ss.d`, and where it isn't 0.

        `curr_depth` edges of the path lie between the sensor and the silhouette. By default, the difference of
        `sample_radiances`: a class overrides one of the two.
        """
        if type(self).sample_radiances is PSIntegrator.sample_radiances:
            raise NotImplementedError(f"{type(self).__name__} needs a method sample_radiance_difference(scene, ss, ..)")
        front, back, _, _ = self.sample_radiances(scene, ss, curr_depth, sampler, active)
        return front - back, dr.any(front != back)

    def sample_radiances(
        self, scene: Scene, ss: SilhouetteSample3f, curr_depth: Any, sampler: Sampler, active: Bool | bool
    ) -> tuple[Color3f, Color3f, SurfaceInteraction3f, Bool]:
        """The radiance of the surface at silhouettes, that of what is behind, its points, and where both are known.

        By default the second is 0, and the first the difference: shadows on points that move then stay behind.
        """
        difference, known = self.sample_radiance_difference(scene, ss, curr_depth, sampler, [], active)
        behind = self.first_hit(scene, ss.spawn_ray(), Bool(active) & known, UInt32(curr_depth) == 0)
        return difference, Color3f(0), behind, known

    def sample_importance(
        self,
        scene: Scene,
        sensor: Sensor,
        ss: SilhouetteSample3f,
        max_depth: Any,
        sampler: Sampler,
        wavelengths: Any,
        active: Bool | bool,
    ) -> tuple[Color3f, Point2f, UInt32, Bool]:
        """The importance that arrives at silhouettes along `ss.d`, by a path of at most `max_depth` edges.

        Returns the importance, the place on the film in pixels, the number of edges from the sensor to the silhouette,
        that along `ss.d` included, and where there is such a path.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method sample_importance(scene, sensor, ss, ..)")

    def sample_viewer(
        self,
        scene: Scene,
        sensor: Sensor,
        ss: SilhouetteSample3f,
        max_depth: Any,
        sampler: Sampler,
        active: Bool | bool,
    ) -> tuple[Color3f, Point2f, UInt32, Bool, Approach | None]:
        """The result of `sample_importance`, and how the path arrives at what sees the silhouettes.

        That is asked for where there are more than two edges. By default it is None: such points don't move.
        """
        return (*self.sample_importance(scene, sensor, ss, max_depth, sampler, [], active), None)

    # ---- derivatives ---------------------------------------------------------------------

    def override_spp(self, integrator_spp: int | None, runtime_spp: int, sampler_spp: int) -> int:
        """The samples per pixel of an estimate: the call's, integrator's or sampler's; 0 if the integrator's is 0."""
        if integrator_spp == 0:
            return 0
        return runtime_spp or integrator_spp or sampler_spp

    def counts(self, sensor: Sensor, spp: int) -> tuple[int, int, int]:
        """The samples per pixel of the three estimates."""
        own = sensor.sampler().sample_count()
        within, primary, indirect = (self.override_spp(n, spp, own) for n in (self.sppc, self.sppp, self.sppi))
        return within, primary, indirect

    def render_forward(self, scene: Scene, params: Any, sensor: Any = 0, seed: Any = 0, spp: int = 0) -> TensorXf:
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Forward, camera) as scene:
            total = dr.zeros(TensorXf, self._shape(camera))
            within, _, _ = self.counts(camera, spp)
            apart = camera_apart(self, scene, camera, spp, forward=True)
            if apart is not None:
                bare = attached_view(scene, {})
                for image in apart.parts_of_image(self, bare, seed, within):
                    dr.forward_to(image, flags=dr.ADFlag.ClearInterior)
                    total += dr.grad(image)
                    dr.eval(total)
                if apart.moving is not None:
                    total += self._in_light_of_emitters().render_forward(bare, params, apart.moving, seed, spp)
                camera = apart.rest
                if nothing_else(scene, camera):
                    return total
            scene = self._with_bodies(scene, camera)
            if self.radiative_backprop and within:
                total += super().render_forward(scene, params, camera, seed, within)
            with dr.resume_grad():
                image = self.render_ad(scene, camera, seed, spp, dr.ADMode.Forward)
                if dr.grad_enabled(image):
                    dr.forward_to(image)
                    total += dr.grad(image)
            return total

    def render_backward(
        self, scene: Scene, params: Any, grad_in: TensorXf, sensor: Any = 0, seed: Any = 0, spp: int = 0
    ) -> None:
        camera = find_sensor(scene, sensor)
        with attached(self, scene, dr.ADMode.Backward, camera) as scene:
            within, _, _ = self.counts(camera, spp)
            apart = camera_apart(self, scene, camera, spp, forward=False)
            if apart is not None:
                bare = attached_view(scene, {})
                for image in apart.parts_of_image(self, bare, seed, within):
                    propagate(image, grad_in)
                    dr.eval()
                if apart.moving is not None:
                    self._in_light_of_emitters().render_backward(bare, params, grad_in, apart.moving, seed, spp)
                camera = apart.rest
                if nothing_else(scene, camera):
                    return
            scene = self._with_bodies(scene, camera)
            if self.radiative_backprop and within:
                super().render_backward(scene, params, grad_in, camera, seed, within)
            with dr.resume_grad():
                image = self.render_ad(scene, camera, seed, spp, dr.ADMode.Backward)
                if dr.grad_enabled(image):
                    propagate(image, grad_in)
        dr.eval()

    def attached_image(self, scene: Scene, sensor: Any, seed: Any, spp: int) -> TensorXf | None:
        camera = find_sensor(scene, sensor)
        within, _, _ = self.counts(camera, spp)
        if (self.radiative_backprop and within) or camera_apart(self, scene, camera, spp, forward=False) is not None:
            return None
        return self.render_ad(self._with_bodies(scene, camera), sensor, seed, spp, dr.ADMode.Backward)

    def _with_bodies(self, scene: Scene, camera: Sensor) -> Scene:
        """The scene with bodies, if surfaces see any shapes but lamps."""
        if self.max_depth <= 2 or self.direct_light_only or not moves(scene, camera):
            return scene
        found: Scene = with_bodies(scene, bool(camera.attached_names()) or has_mirrors(scene))
        return found

    def _in_light_of_emitters(self) -> PSIntegrator:
        """The integrator with no other light."""
        view = copy.copy(self)
        view.max_depth, view.proj_detail = 2, ProjectiveDetail(view)
        return view

    def _shape(self, sensor: Sensor) -> tuple[int, int, int]:
        """The shape of the image."""
        film = sensor.canvas or sensor.film()
        width, height = film.crop_size()
        return height, width, len(film.channel_names()) + len(self.aov_names())

    def render_ad(self, scene: Scene, sensor: Any, seed: Any, spp: int, mode: dr.ADMode) -> TensorXf:
        """An image with the derivatives that `radiative_backprop` doesn't compute; its values are meaningless."""
        sensor = find_sensor(scene, sensor).attached()
        within, primary, indirect = self.counts(sensor, spp)
        total = dr.zeros(TensorXf, self._shape(sensor))
        for camera in sensor.parts():
            total += self._edges(scene, camera, seed, primary, indirect)
        if within and not self.radiative_backprop:
            total += self._attached_image(scene, sensor, seed, within, mode)
        return total

    def _edges(self, scene: Scene, camera: Sensor, seed: Any, primary: int, indirect: int) -> TensorXf:
        """The image of all that jumps, attached, with numbers of samples per pixel for what is seen, and for the rest.

        Each part of a batch has samples of its own.
        """
        total = dr.zeros(TensorXf, self._shape(camera))
        seed = seed + camera.column
        if scene.silhouette_shapes() or camera.attached_names():
            all_edges = scene.replace(silhouettes_of=followed(scene, camera, self.max_depth, self.direct_light_only))
            if primary:
                # As the camera moves, so do all outlines.
                shown = scene.replace(silhouettes_of=outlined(scene, camera))
                total += self._outlines(shown, camera, seed, primary)
            if indirect:
                total += self._lamp_shadows(all_edges, camera, seed, indirect)
            if indirect and not only_lamps_shine(all_edges, self.max_depth, self.direct_light_only):
                with dr.suspend_grad():
                    self.proj_detail.init_indirect_silhouette(all_edges, camera, GUIDING_SEED ^ seed, indirect)
                    sampler, count = self.prepare(camera, INDIRECT_SEED ^ seed, indirect, self.aov_names())
                total += self.render_indirect_silhouette(all_edges, camera, sampler, count)
            total += self._unknown_edges(scene, camera, seed, primary, indirect)
        if primary and camera.has_image_circle and camera.lens_moves():
            sampler, _ = self.prepare(camera, CIRCLE_SEED ^ seed, primary, self.aov_names())
            value, place, found = edge_of_circle(self, scene, camera, sampler)
            total += self._splatted(camera, sampler, place, value, found)
        if indirect:
            total += self._shadow_edges(scene, camera, seed, indirect)
        return total

    def _outlines(self, scene: Scene, camera: Sensor, seed: Any, spp: int) -> TensorXf:
        """The image of the silhouettes that a camera sees; with a lens, of those seen through some points of it."""
        total = dr.zeros(TensorXf, self._shape(camera))
        points = lens_points(camera, LENS_SEED ^ seed, spp)
        for number, point in enumerate(points):
            pinhole = camera.through_lens(point)
            with dr.suspend_grad():
                self.proj_detail.init_primarily_visible_silhouette(scene, pinhole)
                share = -(-spp // len(points))
                sampler, count = self.prepare(pinhole, (PRIMARY_SEED - number) ^ seed, share, self.aov_names())
            total += self.render_primarily_visible_silhouette(scene, pinhole, sampler, count) / len(points)
        return total

    def _shadow_edges(self, scene: Scene, sensor: Sensor, seed: Any, spp: int) -> TensorXf:
        """The image of the edges of shadows in the light of points, and in parallel light; and of those of beams."""
        total = dr.zeros(TensorXf, self._shape(sensor))
        lights = delta_lights(scene)
        if not scene.silhouette_shapes() and not sensor.attached_names():
            lights = [light for light in lights if light.is_moving()]
        for number, light in enumerate(lights):
            sampler, _ = self.prepare(sensor, (SHADOW_SEED + number) ^ seed, -(-spp // len(lights)), self.aov_names())
            parts: list[ShadowEdges | BeamSides] = [ShadowEdges(scene, light)]
            for part in [*parts, BeamSides(scene, light)] if has_sides(light) else parts:
                value, place = part.estimate(self, sensor, sampler)
                total += self._splatted(sensor, sampler, place, value, Bool(True))
        return total

    def _lamp_shadows(self, scene: Scene, sensor: Sensor, seed: Any, spp: int) -> TensorXf:
        """The image of the edges of shadows in the light of lamps, as far as these are followed by themselves."""
        total, lamps = dr.zeros(TensorXf, self._shape(sensor)), shadowed_lamps(scene)
        for number, lamp in enumerate(lamps):
            sampler, _ = self.prepare(sensor, (LAMP_SEED + number) ^ seed, -(-spp // len(lamps)), self.aov_names())
            value, place = LampShadows(scene, lamp).estimate(self, sensor, sampler)
            total += self._splatted(sensor, sampler, place, value, Bool(True))
        return total

    def _unknown_edges(self, scene: Scene, camera: Sensor, seed: Any, primary: int, indirect: int) -> TensorXf:
        """The image of the edges that random lines find, since no shape knows of them."""
        total = dr.zeros(TensorXf, self._shape(camera))
        mirrors, moving = has_mirrors(scene), moving_shapes(scene, camera)
        meetings = shapes_meet(scene, moving)
        if primary and (mirrors or meetings or have_patches(moving)):
            edges = FilmEdges(self, scene, camera, meetings)
            edges.learn(LINE_SEED ^ seed)
            sampler, _ = self.prepare(camera, CUT_SEED ^ seed, primary, self.aov_names())
            value, place, found = edges.estimate(sampler)
            total += self._splatted(camera, sampler, place, value, found)
        # By paths of two edges, other surfaces see lamps alone; what stays shows them no edges but in mirrors.
        seen, several = scene.silhouette_shapes(), self.max_depth > 2
        seen = seen if several else [shape for shape in seen if shape.emitter() is not None]
        # Of a body the lines from its own points sweep over all edges.
        slid_over = scene.bodies.moving if scene.bodies is not None else ()
        along = [scene.geometry.contents.shapes[number] for number in slid_over]
        seen = [*seen, *(shape for shape in along if shape not in seen)]
        meetings = shapes_meet(scene, seen)
        if indirect and not self.direct_light_only and ((mirrors and several) or meetings or have_patches(seen)):
            sampler, _ = self.prepare(camera, PATH_SEED ^ seed, indirect, self.aov_names())
            value, place, found = path_edges(self, scene, camera, sampler, meetings)
            total += self._splatted(camera, sampler, place, value, found)
        return total

    def render_primarily_visible_silhouette(self, scene: Scene, sensor: Sensor, sampler: Sampler, spp: int) -> TensorXf:
        """The image of the silhouettes that the sensor sees, attached to the parameters of shapes.

        The derivative is an integral over the curve on the film, of the difference of radiance times the speed of the
        curve across itself (Li et al. 2018).
        """
        detail = self.proj_detail
        with dr.suspend_grad():
            assert detail.outlines is not None
            ss = detail.outlines.sample(spread(sampler))
            active = ss.is_valid() & (ss.pdf > 0)
            difference, _ = detail.eval_primary_silhouette_radiance_difference(scene, sampler, ss, sensor, active)
            weight = dr.select(active, difference * dr.rcp(ss.pdf), 0)
            ds, _ = on_film(sensor, ss)
            keep(ss, active, weight, ds.uv)
        return self._splatted(sensor, sampler, ds.uv, weight * detail.speed_on_film(scene, sensor, ss, active), active)

    def render_indirect_silhouette(self, scene: Scene, sensor: Sensor, sampler: Sampler, spp: int) -> TensorXf:
        """The image of the silhouettes that other surfaces see, attached to the parameters of shapes; guided."""
        guide = self.proj_detail.guiding_distr
        if guide is None:
            return dr.zeros(TensorXf, self._shape(sensor))
        with dr.suspend_grad():
            point, inverse = guide.sample(sampler)
        value, _, place = self.proj_detail.eval_indirect_integrand(scene, sensor, point, sampler, preprocess=False)
        return self._splatted(sensor, sampler, place, value * inverse, Bool(True))

    def _splatted(
        self, sensor: Sensor, sampler: Sampler, place: Point2f, value: Color3f, active: Bool | bool
    ) -> TensorXf:
        """The image of samples of the whole film, at places in pixels; their mean is the mean of the image.

        It is attached to the samples; its values are 0.
        """
        film = sensor.canvas or sensor.film()
        width, height = sensor.film().crop_size()
        place, active = dr.detach(place + Point2f(sensor.column, 0)), Bool(active)
        keep(place, active)
        channels = [*film.tangent_channels(Color3f(value)), *(Float(0) for _ in self.aov_names())]
        return moving_samples(film, place, channels, active, width * height / sampler.wavefront_size())

    def first_hit(
        self, scene: Scene, ray: Any, active: Bool, from_sensor: Bool | bool = True, flags: int = int(RayFlags.All)
    ) -> SurfaceInteraction3f:
        """The first surface point along rays, which pass through emitters `from_sensor` if these are hidden."""
        if not self.hide_emitters:
            return scene.ray_intersect(ray, flags, active=active)
        found = scene.closest_hit(dr.detach(ray), active, through_lights=Bool(from_sensor))
        return scene.surface_interaction_of(found, ray, flags)

    def hides(self, scene: Scene, ray: Any, active: Bool | bool) -> Bool:
        """Whether something hides the end of rays from the sensor: with `hide_emitters` no lamps do."""
        if not self.hide_emitters:
            return scene.ray_test(ray, active)
        return scene.closest_hit(ray, active, through_lights=Bool(True)).is_valid()

    def hides_point(self, scene: Scene, si: SurfaceInteraction3f, p: Point3f, active: Bool | bool) -> Bool:
        """Whether something hides surface points from places `p` on the sensor, whose rays hit them exactly.

        Rays back to the sensor leave so close to the surface that rounding lets them.
        """
        ray = si.spawn_ray_to(p)
        ray.o = dr.lerp(si.p, ray.o, CLOSE_TO_SURFACE)
        ray.d = p - ray.o
        return self.hides(scene, ray, active)

    def seed_rays(self, scene: Scene, sensor: Sensor, sampler: Sampler) -> tuple[Any, Bool]:
        """The rays of paths that `sample` offers for projection."""
        ray, _, _ = self.sample_rays(scene, sensor, sampler)
        options = modes(dr.ADMode.Primal, scene, sampler, ray)
        rays, active = self.sample(**options, δL=None, δaovs=None, state_in=None, project=True)[3]
        return rays, active

    def both_sides(
        self, scene: Scene, ss: SilhouetteSample3f, from_sensor: Bool | bool, active: Bool | bool
    ) -> tuple[SurfaceInteraction3f, SurfaceInteraction3f, SurfaceInteraction3f, Bool]:
        """What viewers see at silhouettes, and behind them; the hits there; and where both are known: see `foreground`.

        In narrow wedges what is seen on both sides is looked at off the edge, and isn't where rays hit it. Of textures
        that jump, silhouettes show what is at the inner border of the strip `ss.strip`.
        """
        front, known = foreground(scene, scene.silhouette_shapes(), ss, active & nothing_at(scene, ss, active))
        behind = self.first_hit(scene, ss.spawn_ray(), known, from_sensor)
        if has_strips(scene):
            patches = Patches(scene.geometry.contents.shapes)
            # Random lines find the edges of patches, also where these are edges of triangles.
            known = known & ~patches.differ(front, behind)
            begin = ss.p - ss.sight * ss.d - ss.strip * ss.n
            inner = scene.ray_intersect(Ray3f(begin, ss.d), active=known & (ss.strip > 0))
            there = inner.is_valid() & (inner.shape_index == front.shape_index)
            other = there & (patches.number(inner) != patches.number(front))
            front = front.replaced(uv=dr.select(other, inner.uv, front.uv))
            if has_mirrors(scene):
                chains = Chains(self, scene, self.max_depth - 2, False)
                inner, _, other = beside_outline(chains, inner, ss.d, front, there)
                front = dr.select(other, inner, front)
        seen, seen_behind = clear_of_wedges(scene, front, behind, ss.d, known & close_together(front, behind, ss.d))
        return seen.si, seen_behind.si, behind, known

    def radiance_along(
        self,
        scene: Scene,
        ray: Any,
        si: SurfaceInteraction3f,
        depth: Any,
        sampler: Sampler,
        active: Bool,
        horizon: Vector3f,
    ) -> Color3f:
        """The radiance along rays that hit `si`, after a number of edges, with a horizon: see `BesideEdge`.

        Where the shading normal of an outline points away from the viewer, it is bent until it doesn't.
        """
        shown = toward_viewer(si, ray.d)
        return dr.select(active, self.shade(scene, sampler, ray, depth, shown, active, horizon=horizon), 0)

    def shade(
        self,
        scene: Scene,
        sampler: Sampler,
        ray: Any,
        depth: Any,
        si: SurfaceInteraction3f | None,
        active: Any,
        **kwargs: Any,
    ) -> Color3f:
        """The radiance along rays, or from surface points; `kwargs` are those of `sample`."""
        options = {**modes(dr.ADMode.Primal, scene, sampler, ray), "depth": depth, "active": Bool(active)}
        return Color3f(self.sample(**options, δL=None, δaovs=None, state_in=None, si_shade=si, **kwargs)[0])


def nothing_else(scene: Scene, camera: Sensor) -> bool:
    """Whether nothing moves, this view of the camera included, and the scene reads no values with gradients."""
    if moves(scene, camera) or not isinstance(scene.lookup, Attached):
        return False
    return not any(scene.lookup.attaches(leaf) for ensemble in scene.ensembles() for leaf in ensemble.leaves())


def shapes_meet(scene: Scene, moving: list[Any]) -> bool:
    """Whether some shapes may cut or touch others."""
    return bool(moving) and (recording() or next(meeting_pairs(scene.shapes(), moving), None) is not None)


def moving_shapes(scene: Scene, sensor: Sensor) -> list[Any]:
    """The shapes whose place in the picture changes: those that move, or all if the sensor does."""
    shapes: list[Any] = scene.shapes() if sensor.attached_names() else scene.silhouette_shapes()
    return shapes


def optional(props: Properties, name: str) -> int | None:
    """A whole number, or None if it isn't given."""
    found = props.integer(name, -1, low=-1)
    return None if found < 0 else found


def on_film(sensor: Sensor, ss: SilhouetteSample3f) -> tuple[DirectionSample3f, Color3f]:
    """The way from silhouettes to the sensor, with the place on the film in pixels, and the importance."""
    it = dr.zeros(Interaction3f)
    it.p = ss.p
    found: tuple[DirectionSample3f, Color3f] = sensor.sample_direction(it, Point2f(0))
    return found
