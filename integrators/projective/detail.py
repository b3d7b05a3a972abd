"""The parts of projective sampling: silhouettes that the camera sees, and those that other surfaces see.

Z. Zhang, N. Roussel and W. Jakob, "Projective Sampling for Differentiable Rendering of Geometry", ACM Trans. Graph.
42(6), 2023.
"""

from __future__ import annotations

import copy
from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import SHADOW_EPSILON, DiscontinuityFlags, Interaction3f, RayFlags, SurfaceInteraction3f
from djpt.errors import RenderError
from djpt.integrators.projective.crossings import PRECISION, STRIP
from djpt.integrators.projective.film_geometry import film_vectors, place_on_film, swept_area, viewpoint_of
from djpt.integrators.projective.guiding import (
    UNIFORM_SHARE,
    BaseGuidingDistr,
    GridDistr,
    OcSpaceDistr,
    UniformDistr,
    effective_number,
    places_of,
)
from djpt.integrators.projective.kept import keep
from djpt.integrators.projective.outlines import Outlines
from djpt.integrators.projective.projection import ProjectOperation
from djpt.integrators.projective.reattach import has_mirrors
from djpt.integrators.projective.receivers import Receiver, light_of_lamps
from djpt.jit.frozen import recording
from djpt.jit.types import Bool, Color3f, Float, Point2f, Point3f, UInt32
from djpt.sensors.mapped import MappedCamera
from djpt.shapes.silhouettes.samples import SilhouetteSample3f
from djpt.textures.patches import have_patches

__all__ = ["ProjectiveDetail"]

TRIALS, RARE = 1 << 14, 3e-3
"""The random silhouettes that tell whether a guide pays, and the efficiency of such silhouettes below which it does."""

FEW_SAMPLES = 1 << 20
"""If fewer samples count, the octree is learnt from all of them."""


class ProjectiveDetail:
    """The part of a `PSIntegrator`, `parent`, that computes derivatives at silhouettes."""

    ProjectOperation = ProjectOperation

    def __init__(self, parent: Any) -> None:
        self.parent = parent
        self.outlines: Outlines | None = None
        self.guiding_distr: BaseGuidingDistr | None = None

    # ---- silhouettes that the camera sees ----------------------------------------------------

    def init_primarily_visible_silhouette(self, scene: Any, sensor: Any) -> None:
        """Find the silhouettes as the sensor sees them, of all shapes that move."""
        shapes, viewpoint = scene.silhouette_shapes(), dr.detach(viewpoint_of(scene, sensor))
        if isinstance(sensor, MappedCamera) and not sensor.is_central:
            sight, radius = detached(sensor).sight, sensor.viewpoint_radius()
            self.outlines = Outlines(shapes, viewpoint, creases=True, sight=sight, within=radius)
        else:
            self.outlines = Outlines(shapes, viewpoint, creases=True)

    def sample_primarily_visible_silhouette(
        self, scene: Any, viewpoint: Any, sample2: Point2f, active: Bool | bool
    ) -> SilhouetteSample3f:
        """A point of the silhouettes as the sensor sees them; `pdf` is per unit length."""
        assert self.outlines is not None
        return self.outlines.sample(sample2, active)

    def speed_on_film(self, scene: Any, sensor: Any, ss: SilhouetteSample3f, active: Bool | bool) -> Float:
        """The area that a unit of length of outlines sweeps on the film, a unit square: 0, attached.

        Points stick to their shapes, and the film moves with the sensor: both count.
        """
        assert self.outlines is not None
        moved = place_on_film(sensor, self.outlines.follow(ss, active, viewpoint_of(scene, sensor)))
        return dr.select(active, swept_area(sensor, ss, moved - dr.detach(moved)), 0)

    def sensor_jacobian(self, sensor: Any, ss: SilhouetteSample3f) -> Float:
        """The area on the film, which is a unit square, of the unit square of `silhouette_d` and `n` at silhouettes."""
        a, b = film_vectors(sensor, ss)
        return dr.abs(a.x * b.y - a.y * b.x)

    def eval_primary_silhouette_radiance_difference(
        self, scene: Any, sampler: Any, ss: SilhouetteSample3f, sensor: Any, active: Bool | bool = True
    ) -> tuple[Color3f, list[Float]]:
        """The difference of radiance at silhouettes that the sensor sees, and no wavelengths; 0 where it doesn't.

        Raises:
            RenderError: the sensor is no camera with a place, nor one with parallel rays.
        """
        with dr.suspend_grad():
            ray = ss.toward_viewer().spawn_ray()
            it = dr.zeros(Interaction3f)
            it.p = ss.p
            distance = sensor.sample_direction(it, Point2f(0))[0].dist
            ray.maxt = distance * (1 - SHADOW_EPSILON)
            if has_strips(scene):
                window = Point2f(sensor.film().crop_size())
                width = STRIP * PRECISION * dr.max(window)
                ss = ss.replaced(sight=distance, strip=width / dr.norm(window * film_vectors(sensor, ss)[1]))
            _, importance = sensor.sample_direction(it, Point2f(0), Bool(active))
            if self.parent.hide_emitters:
                # Lamps are passed by, and so have no outlines.
                for number, shape in enumerate(scene.silhouette_shapes()):
                    if shape.emitter() is not None:
                        active = active & (ss.scene_index != number)
            visible = active & ~self.parent.hides(scene, ray, active) & dr.any(importance != 0)
            difference, found = self.parent.sample_radiance_difference(scene, ss, 0, sampler, [], visible)
            return dr.select(visible & found, difference, 0), []

    # ---- silhouettes that other surfaces see ---------------------------------------------------

    def get_projected_points(self, scene: Any, sensor: Any, sampler: Any) -> tuple[Point3f, Bool]:
        """The points in the space of silhouettes that rays of paths are projected to, and True where there are any."""
        parent = self.parent
        operation = ProjectOperation(parent.proj_mesh_algo, parent.proj_mesh_max_walk, parent.proj_mesh_max_jump)
        rays, active = parent.seed_rays(scene, sensor, sampler)
        # Paths, projections, and what is asked of points are kernels of their own: the time to compile one grows faster
        # than its length.
        dr.eval(rays, active)
        partials = RayFlags.dNSdUV if parent.proj_mesh_algo == "jump" else RayFlags.Empty
        si = scene.ray_intersect(rays, RayFlags.All | partials, active=active)
        active = active & si.is_valid()
        ss, active = operation.eval(scene, rays, si, sampler, active)
        points = scene.invert_silhouette_sample(ss, active)
        dr.eval(points, active)
        return points, active

    def init_indirect_silhouette(self, scene: Any, sensor: Any, seed: Any, spp: int = 0) -> None:
        """Learn where indirect silhouettes matter, by the method that the parent's `guiding` names.

        Args:
            scene: the scene.
            sensor: the camera.
            seed: the seed.
            spp: the samples per pixel that will be guided; 0: many.
        """
        parent = self.parent
        if parent.guiding == "none" or (parent.guiding == "auto" and not self._pays(scene, sensor, seed, spp)):
            self.guiding_distr = UniformDistr()
        elif parent.guiding in ("auto", "octree"):
            self.init_indirect_silhouette_octree(scene, sensor, seed)
        elif parent.guiding_proj:
            self.init_indirect_silhouette_grid_proj(scene, sensor, seed)
        else:
            self.init_indirect_silhouette_grid_unif(scene, sensor, seed)

    def _pays(self, scene: Any, sensor: Any, seed: Any, spp: int) -> bool:
        """Whether learning an octree pays: always if more is guided than learnt from, else if random points rarely hit.

        With m the mass at random points, E[m]^2 / E[m^2] is the part of their number that is as good as points in
        proportion to m. Frozen functions can't ask, and learn.
        """
        if recording() or not 0 < spp < self.parent.proj_seed_spp * self.parent.guiding_rounds:
            return True
        sampler = sensor.sampler().clone()
        sampler.seed(seed ^ 0x3333CCCC, TRIALS)
        points = Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
        return effective_number(self._mass(scene, sensor, points, sampler)) <= RARE * TRIALS

    def init_indirect_silhouette_grid_unif(self, scene: Any, sensor: Any, seed: Any) -> None:
        """Learn a grid from a random point in each cell and round."""
        parent, grid = self.parent, self._grid()
        sampler = sensor.sampler().clone()
        total = dr.zeros(Float, grid.num_cells)
        for k in range(parent.guiding_rounds):
            sampler.seed(k + seed, grid.num_cells)
            total += self._mass(scene, sensor, grid.random_cell_sample(sampler), sampler)
            dr.eval(total)
        self._use(grid, total / parent.guiding_rounds)

    def init_indirect_silhouette_grid_proj(self, scene: Any, sensor: Any, seed: Any) -> None:
        """Learn a grid from projected paths: the mass of a cell is the mean of its samples."""
        parent, grid = self.parent, self._grid()
        spp = self._seed_spp(sensor, grid.num_cells)
        total = dr.zeros(Float, grid.num_cells)
        for k in range(parent.guiding_rounds):
            sampler, _ = parent.prepare(sensor, k + (seed ^ 0x5555AAAA), spp, parent.aov_names())
            points, active = self.get_projected_points(scene, sensor, sampler)
            cell = grid.sample_to_cell_idx(points, active)
            mass = self._mass(scene, sensor, points, sampler, active)
            sums, counts = dr.zeros(Float, grid.num_cells), dr.zeros(Float, grid.num_cells)
            dr.scatter_add(sums, mass, cell, active)
            dr.scatter_add(counts, Float(1), cell, active)
            total += sums / dr.maximum(counts, 1)
            dr.eval(total)
        self._use(grid, total / parent.guiding_rounds)

    def _grid(self) -> GridDistr:
        parent = self.parent
        reso, least = parent.guiding_grid_reso, parent.clamp_mass_thres
        return GridDistr(reso, least, parent.scale_mass, uniform_share=UNIFORM_SHARE)

    def _use(self, grid: GridDistr, mass: Float) -> None:
        """Guide by a grid, unless nothing was found."""
        self.guiding_distr = UniformDistr()
        if dr.any(mass > 0):
            grid.set_mass(mass)
            self.guiding_distr = grid

    def _seed_spp(self, sensor: Any, cells: int) -> int:
        """The samples per pixel that are projected: `proj_seed_spp`, or if that is 0 one per cell."""
        width, height = sensor.film().crop_size()
        return self.parent.proj_seed_spp or cells // (width * height) + 1

    def init_indirect_silhouette_octree(self, scene: Any, sensor: Any, seed: Any) -> None:
        """Learn an octree from projected paths, or from uniform points of the space of silhouettes."""
        parent = self.parent

        def integrand(points: Point3f, sampler: Any) -> Any:
            return Color3f(self._mass(scene, sensor, points, sampler)), [], Point2f(0)

        tree = OcSpaceDistr(
            parent.octree_max_depth,
            parent.octree_max_leaf_cnt,
            parent.octree_extra_leaf_sample,
            integrand,
            parent.octree_construction_mean_mult,
            parent.clamp_mass_thres,
            parent.octree_highres_x_slices,
            parent.octree_scatter_inc,
            parent.scale_mass,
            uniform_share=UNIFORM_SHARE,
        )
        nx, ny, nz = parent.guiding_grid_reso
        if parent.guiding_proj:
            spp = self._seed_spp(sensor, nx * ny * nz) * parent.guiding_rounds
            sampler, _ = parent.prepare(sensor, seed ^ 0x5555AAAA, spp, parent.aov_names())
            points, active = self.get_projected_points(scene, sensor, sampler)
        else:
            sampler = sensor.sampler().clone()
            sampler.seed(seed ^ 0x5555AAAA, nx * ny * nz)
            points, active = Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d()), Bool(True)
        mass = self._mass(scene, sensor, points, sampler, active)
        dr.eval(points, mass)
        self.guiding_distr = UniformDistr()
        count = dr.width(places_of(mass > 0))
        if not count:
            return
        tree.mass_contruction_thres = parent.octree_contruction_thres
        if tree.mass_contruction_thres == 0 and count >= FEW_SAMPLES:
            tree.mass_contruction_thres = float(dr.sum(mass)[0]) / count * parent.octree_construction_mean_mult
        try:
            tree.set_points(points, mass, seed)
        except RenderError:
            # Random points of the leaves find nothing: all points are alike.
            return
        self.guiding_distr = tree

    def _mass(self, scene: Any, sensor: Any, points: Any, sampler: Any, active: Bool | bool = True) -> Float:
        """The density that a guide learns: the largest channel of the integrand, without the speed; finite."""
        value, _, _ = self.eval_indirect_integrand(scene, sensor, points, sampler, preprocess=True, active=active)
        mass = dr.max(value)
        return dr.select(dr.isfinite(mass), mass, 0)

    def eval_indirect_integrand(
        self, scene: Any, sensor: Any, sample: Any, sampler: Any, preprocess: bool, active: Bool | bool = True
    ) -> tuple[Color3f, list[Float], Point2f]:
        """The integrand of the derivative by indirect silhouettes at points of the unit cube.

        Returns the value, no wavelengths, and the place on the film in pixels. The value is attached to the parameters
        of shapes, or, for `preprocess`, the absolute value without the speed of silhouettes.
        """
        parent, sensor = self.parent, seen_through(sensor, sampler)
        with dr.suspend_grad():
            # Of an edge of a mesh only the directions that part its triangles, which are few.
            flags = DiscontinuityFlags.AllTypes | DiscontinuityFlags.Creases | DiscontinuityFlags.DirectionLune
            ss = scene.sample_silhouette(Point3f(sample), int(flags), active)
            active = active & ss.is_valid()
            importance, place, edges, reached, approach = parent.sample_viewer(
                scene, sensor, ss, parent.max_depth, sampler, active
            )
            active = active & reached
            if has_strips(scene):
                distance = scene.ray_intersect(ss.toward_viewer().spawn_ray(), active=active).t
                ss = ss.replaced(sight=distance, strip=STRIP * PRECISION * distance)
            front, back, behind, known = parent.sample_radiances(scene, ss, edges - 1, sampler, active)
            active = active & known
            back = back - light_of_lamps(scene, behind, active)
            weight = dr.select(active, importance * (ss.foreshortening * dr.rcp(ss.pdf)), 0)
            if preprocess:
                receiver = Receiver(parent, scene, sensor, ss, place, edges, approach, active)
                moving = [k for k, s in enumerate(scene.silhouette_shapes()) if s.parameters_grad_enabled()]
                jump = dr.select(is_one_of(ss.scene_index, moving), dr.abs(front - back), 0)
                passed = dr.select(receiver.sees_itself(number_of(scene, ss), active), dr.abs(front - back), back)
                return weight * (jump + passed * receiver.reach()), [], Point2f(0)
            keep(ss, active, weight, front, back, behind.t, behind.shape_index, place, edges, approach)
        receiver = Receiver(parent, scene, sensor, ss, place, edges, approach, active)
        in_front = receiver.sees_itself(number_of(scene, ss), active)
        at_back = receiver.sees_itself(behind.shape_index, active & behind.is_valid())
        speed = receiver.speed()
        passed = Color3f(back) * dr.select(at_back, speed, receiver.speed_at_edge(behind.t))
        passed -= Color3f(front) * dr.select(in_front, speed, 0)
        return Color3f(weight) * (Color3f(front - back) * self.speed(scene, ss, active) + passed), [], place

    def speed(self, scene: Any, ss: SilhouetteSample3f, active: Bool | bool) -> Float:
        """The speed of silhouettes along their normals: 0, attached to the parameters of the shapes."""
        si = dr.zeros(SurfaceInteraction3f)
        si.p, si.prim_index, si.uv = dr.detach(ss.p), ss.prim_index, ss.uv
        followed = scene.silhouette_shape(ss.scene_index).differential_motion(si, active)
        return dr.select(active, dr.dot(followed - dr.detach(followed), dr.detach(ss.n)), 0)


def has_strips(scene: Any) -> bool:
    """Whether edges run along outlines: of patches, or of what smooth surfaces show."""
    return has_mirrors(scene) or have_patches(scene.geometry.contents.shapes)


def number_of(scene: Any, ss: SilhouetteSample3f) -> UInt32:
    """The numbers of the shapes on which silhouettes are."""
    shapes = scene.geometry.contents.shapes
    numbers = UInt32([shapes.index(shape) for shape in scene.silhouette_shapes()])
    return dr.gather(UInt32, numbers, ss.scene_index, ss.is_valid())


def detached(sensor: Any) -> Any:
    """A view of a sensor that doesn't move."""
    view = copy.copy(sensor)
    for name in sensor.values:
        setattr(view, name, dr.detach(getattr(sensor, name)))
    return view


def seen_through(sensor: Any, sampler: Any) -> Any:
    """A sensor, of one with a lens what is seen through a random point of it in each lane."""
    return sensor.through_lens(sampler.next_2d()) if sensor.needs_aperture_sample() else sensor
