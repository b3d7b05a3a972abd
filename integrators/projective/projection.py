"""Projections of hits onto silhouettes.

A ray of a path that hits a moving shape is projected: its origin is the viewpoint, and the hit is moved over the
surface until it lies on the silhouette that is seen from there. Z. Zhang, N. Roussel and W. Jakob, "Projective Sampling
for Differentiable Rendering of Geometry", ACM Trans. Graph. 42(6), 2023, section 4.
"""

from __future__ import annotations

from typing import Any

import drjit as dr

from djpt.core.lookup import is_one_of
from djpt.core.records import RAY_EPSILON, DiscontinuityFlags, Ray3f, RayFlags, SurfaceInteraction3f
from djpt.errors import RenderError
from djpt.jit.types import PCG32, Bool, Float, Point3f, UInt32, UInt64
from djpt.shapes.silhouettes.samples import SilhouetteSample3f

__all__ = ["ProjectOperation"]

PERIMETER, INTERIOR = DiscontinuityFlags.PerimeterType, DiscontinuityFlags.InteriorType
CREASES = DiscontinuityFlags.Creases
ALGORITHMS = ("hybrid", "walk", "jump")


class ProjectOperation:
    """Projects rays.

    Args:
        mesh_proj_algo: how hits on meshes are moved: `walk`, from triangle to triangle; `jump`, along the plane of the
            normals to where they turn away, and back onto the mesh; `hybrid`, a walk and, where it fails, a jump.
        max_walk: the triangles of a walk at most.
        max_jump: the jumps at most.

    Raises:
        RenderError: another algorithm.
    """

    def __init__(self, mesh_proj_algo: str, max_walk: int, max_jump: int) -> None:
        if mesh_proj_algo not in ALGORITHMS:
            raise RenderError(f"mesh_proj_algo must be one of {', '.join(ALGORITHMS)}, found '{mesh_proj_algo}'")
        self.mesh_proj_algo, self.max_walk, self.max_jump = mesh_proj_algo, max_walk, max_jump

    def eval(
        self, scene: Any, ray_guide: Ray3f, si_guide: SurfaceInteraction3f, sampler: Any, active: Bool
    ) -> tuple[SilhouetteSample3f, Bool]:
        """The silhouettes that rays are projected to, and True where there are any.

        Args:
            scene: the scene.
            ray_guide: the rays.
            si_guide: their hits.
            sampler: a source of random numbers.
            active: the lanes that matter.
        """
        shapes = scene.silhouette_shapes()
        number, on_moving = UInt32(0), Bool(False)
        for k, shape in enumerate(shapes):
            mine = si_guide.shape == shape
            number, on_moving = dr.select(mine, UInt32(k), number), on_moving | mine
        active = active & on_moving
        state = UInt64(sampler.next_1d() * 2**32) << 16 | UInt64(sampler.next_1d() * 2**16)
        kinds = {shape.silhouette_class(): shape for shape in shapes}
        si_guide.shape = scene.silhouette_shape(number)
        result = SilhouetteSample3f()
        for kind, example in kinds.items():
            mine = active & is_one_of(number, [k for k, s in enumerate(shapes) if s.silhouette_class() is kind])
            if example.of_triangles:
                found = self.project_mesh(scene, ray_guide, si_guide, state, mine)
            else:
                types = example.silhouette_discontinuity_types()
                found = self.project_analytic(scene, ray_guide, si_guide, state, mine, types)
            result = dr.select(mine, found, result)
        result.scene_index = number
        return result, active & result.is_valid()

    # ---- shapes with formulas ----------------------------------------------------------------

    def project_analytic(
        self,
        scene: Any,
        ray_guide: Ray3f,
        si: Any,
        state: UInt64,
        active: Bool,
        types: int = int(PERIMETER | INTERIOR),
    ) -> SilhouetteSample3f:
        """The point that the shape's own formula gives: on an edge or rim, or where the surface turns away.

        Where there are both, chance decides.
        """
        if types != PERIMETER | INTERIOR:
            return projected(si, ray_guide, types | CREASES, random(si, state).next_float32(active), active)
        side = projected(si, ray_guide, INTERIOR, Float(0), active)
        rim = projected(si, ray_guide, PERIMETER, Float(0), active)
        on_rim = ~side.is_valid() | (random(si, state).next_float32(active) > 0.5)
        ss = dr.select(on_rim, rim, side)
        ss.flags = UInt32(int(PERIMETER | INTERIOR))
        return ss

    project_sphere = project_disk = project_rectangle = project_cylinder = project_analytic

    # ---- meshes --------------------------------------------------------------------------------

    def project_mesh(
        self, scene: Any, ray_guide: Ray3f, si_guide: Any, state: UInt64, active: Bool
    ) -> SilhouetteSample3f:
        """A point of an edge that is on the silhouette, by the algorithm that was chosen; none if it isn't found."""
        if self.mesh_proj_algo == "jump":
            ss, valid = self.mesh_jump(scene, si_guide, ray_guide.o, state, active, self.max_jump)
        elif self.mesh_proj_algo == "walk":
            ss, _, valid = self.mesh_walk(si_guide, ray_guide.o, state, active, self.max_walk)
        else:
            ss, valid = self.hybrid_mesh_projection(scene, si_guide, ray_guide.o, state, active, self.max_walk)
        ss.discontinuity_type = dr.select(valid, ss.discontinuity_type, 0)
        ss.flags = UInt32(int(PERIMETER | DiscontinuityFlags.DirectionLune | CREASES))
        return ss

    def mesh_walk(
        self, si: Any, viewpoint: Point3f, state: UInt64, active: Bool, max_move: int
    ) -> tuple[SilhouetteSample3f, UInt64, Bool]:
        """Walk over the mesh, to where it turns away most likely; the last edge, the random state, where it's reached.

        The walk doesn't end at the first silhouette, so that all of them are found.
        """
        shape = si.shape
        lanes = dr.width(si)
        start = SurfaceInteraction3f(prim_index=si.prim_index)
        ss = wide(shape.primitive_silhouette_projection(viewpoint, start, PERIMETER, Float(0), active), lanes)
        ss.discontinuity_type = dr.zeros(UInt32, lanes)
        generator = PCG32(size=lanes, initstate=state)
        flags = PERIMETER | DiscontinuityFlags.HeuristicWalk | CREASES

        def step(depth: UInt32, here: UInt32, target: UInt32, ss: Any, generator: Any) -> Any:
            u = generator.next_float32()
            found = shape.primitive_silhouette_projection(
                viewpoint, SurfaceInteraction3f(prim_index=target), flags, u, active
            )
            return depth + 1, UInt32(target), UInt32(found.prim_index), found, generator

        prim = UInt32(si.prim_index)
        state0 = (dr.zeros(UInt32, lanes), UInt32(prim), UInt32(prim), ss, generator)
        _, here, _, ss, generator = dr.while_loop(
            state0, lambda depth, *_: active & (depth < max_move), step, label="walk over a mesh"
        )
        # The edge belongs to the triangle that the last step started from.
        ss.prim_index = here
        return ss, generator.state, active & ss.is_valid()

    def mesh_jump(
        self, scene: Any, si: Any, viewpoint: Point3f, state: UInt64, active: Bool, max_jump: int
    ) -> tuple[SilhouetteSample3f, Bool]:
        """Jump to where the interpolated normals turn away from the viewer, until an edge is on the silhouette."""
        shape = si.shape
        u = random(si, state).next_float32(active)
        ss = shape.primitive_silhouette_projection(viewpoint, si, PERIMETER | CREASES, u, active)
        valid = active & ss.is_valid()
        for _ in range(max_jump):
            active = active & ~valid
            toward, n = dr.normalize(viewpoint - si.p), si.sh_frame.n
            a, b, c = dr.dot(toward, si.dn_du), dr.dot(toward, si.dn_dv), dr.dot(toward, n)
            step = -c * dr.rcp(a * a + b * b)
            p = si.p + step * (a * si.dp_du + b * si.dp_dv)
            n = dr.normalize(n + step * (a * si.dn_du + b * si.dn_dv))
            active = active & dr.isfinite(dr.sum(p) + dr.sum(n))
            si = scene.ray_intersect(
                Ray3f(dr.fma(n, RAY_EPSILON, p), -n), RayFlags.AllNonDifferentiable | RayFlags.dNSdUV, active=active
            )
            active = active & si.is_valid() & (si.shape == shape)
            found = shape.primitive_silhouette_projection(viewpoint, si, PERIMETER | CREASES, u, active)
            hit = active & found.is_valid()
            ss, valid = dr.select(hit, found, ss), valid | hit
        return ss, valid

    def hybrid_mesh_projection(
        self, scene: Any, si: Any, viewpoint: Point3f, state: UInt64, active: Bool, max_move: int
    ) -> tuple[SilhouetteSample3f, Bool]:
        """A walk, and where it hasn't ended at a silhouette one jump from the middle of its last triangle."""
        ss, state, valid = self.mesh_walk(si, viewpoint, state, active, max_move)
        remaining = active & ~valid
        shape, place, n = si.shape, Point3f(si.p), Point3f(si.n)
        for mesh_number, mesh in enumerate(scene.silhouette_shapes()):
            if mesh.of_triangles:
                mine = shape.index == mesh_number
                own = remaining & mine
                corners = [mesh.vertex_position(k, own) for k in mesh.face_indices(ss.prim_index, own)]
                place = dr.select(mine, dr.detach((corners[0] + corners[1] + corners[2]) / 3), place)
                n = dr.select(mine, dr.detach(mesh.face_normal(ss.prim_index, own)), n)
        height = RAY_EPSILON * (1 + dr.max(dr.abs(place)))
        above = scene.ray_intersect(
            Ray3f(dr.fma(n, height, place), -n),
            RayFlags.AllNonDifferentiable | RayFlags.dNSdUV,
            active=remaining,
        )
        remaining = remaining & above.is_valid() & (above.shape == shape)
        above.shape = shape
        jumped, landed = self.mesh_jump(scene, above, viewpoint, state, remaining, 1)
        return dr.select(landed, jumped, ss), valid | landed


def projected(si: Any, ray: Ray3f, flags: int, sample: Float, active: Bool) -> SilhouetteSample3f:
    """The projection by the shape's own formula."""
    found: SilhouetteSample3f = si.shape.primitive_silhouette_projection(ray.o, si, int(flags), sample, active)
    return found


def random(si: Any, state: UInt64) -> Any:
    """A source of random numbers for the lanes of some hits."""
    return PCG32(size=dr.width(si), initstate=state)


def wide(record: Any, lanes: int) -> Any:
    """A copy of a record with this many lanes in all its fields, as loops require of their state."""
    spread = dr.zeros(type(record), lanes)
    return dr.select(dr.full(Bool, True, lanes), record, spread)
