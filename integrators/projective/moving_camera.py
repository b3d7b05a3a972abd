"""What becomes of an image as its camera alone moves, if all vertices of paths stay where they are.

What moves is the place of first vertices on the film: see "Cameras that move alone" in
`docs/theory/moving-geometry.md`. Four estimates are added up: of vertices within the film; of those at its border, or
at that of each pixel if the filter is a box; of those in a medium at the near plane; and of outlines, behind which
vertices appear and disappear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import drjit as dr

from djpt.core.records import SHADOW_EPSILON, BSDFFlags, Interaction3f, Ray3f
from djpt.films.moving_samples import moving_samples
from djpt.integrators.paths.transmittance import way_through
from djpt.integrators.projective.film_geometry import place_on_film, swept_area, viewpoint_of
from djpt.integrators.projective.first_vertex import FirstVertex
from djpt.integrators.projective.outlines import Outlines
from djpt.integrators.projective.spread import BELOW_ONE, hammersley, lens_points, spread
from djpt.jit.types import Bool, Color3f, Float, Point2f, TensorXf, UInt32
from djpt.shapes.silhouettes.foreground import foreground, nothing_at
from djpt.shapes.silhouettes.seams import turns_dark

__all__ = ["Samples", "at_borders", "parts_of_image", "within"]

WITHIN_SEED, BORDER_SEED, OUTLINE_SEED, LENS_SEED, NEAR_SEED = 0x0, 0x66666666, 0x99999999, 0x55555555, 0x33333333
"""Combined with the seed of the image, for samples of their own."""

CLOSE = 0.25
"""The distance, in radii of the scene, within which vertices in a medium are sampled by themselves: the closer they are
to the camera, the faster they move on the film."""

AHEAD = 1e-3
"""The distance from the near plane at which vertices stand for those on it, in those of the plane."""

MOST_LANES = 1 << 21
"""The samples of a pass, at most, unless there are more pixels."""


def parts_of_image(
    integrator: Any, scene: Any, sensor: Any, spp: int, seed: Any, indirect: bool = False, kind: Any = None
) -> Iterator[TensorXf]:
    """The parts of an image, whose values are 0, each attached to what places the camera; gradients are resumed.

    A part is made when it is asked for, and holds its samples in memory.

    Args:
        integrator: a `djpt.integrators.volpath.VolumetricPath`, or what samples of that `kind` ask for.
        scene: the scene.
        sensor: the camera, or a batch.
        spp: the samples per pixel.
        seed: their seed.
        indirect: whether light of emitters is left out, seen by the camera or by what it sees; in scenes without media.
        kind: the class of samples, by default `Samples`.
    """
    kind = kind or Samples
    width, height = sensor.film().crop_size()
    most = max(1, MOST_LANES // (width * height))
    for number, part in enumerate(sensor.parts()):
        view = scene.replace(sensor=part)
        for turn, done in enumerate(range(0, spp, most)):
            share, own_seed = min(most, spp - done), (seed + 0x9E37 * turn) ^ number
            for term in kind.terms():
                with dr.resume_grad():
                    camera = sensor.attached().parts()[number]
                    image = term(kind(integrator, view, camera, share, own_seed, spp, indirect))
                    if dr.grad_enabled(image):
                        yield image


class Samples:
    """What the estimates of a pass are made of."""

    @staticmethod
    def terms() -> Sequence[Callable[[Samples], TensorXf]]:
        """The estimates: each makes an image."""
        return within, at_borders, at_near_plane, at_outlines

    def __init__(
        self, integrator: Any, scene: Any, camera: Any, spp: int, seed: Any, total: int, indirect: bool
    ) -> None:
        self.integrator, self.scene, self.camera = integrator, scene, camera
        self.spp, self.seed, self.total, self.indirect = spp, seed, total, indirect
        self.film = camera.canvas or camera.film()
        self.window = camera.film().crop_size()
        self.by_pixel = self.film.rfilter().is_box_filter()
        medium = scene.camera_medium
        self.in_medium = medium is not None and bool(dr.any(scene.media.fill(medium)))

    def sampler(self, salt: int, spp: int) -> Any:
        """The random numbers of `spp` samples per pixel."""
        width, height = self.window
        return self.camera.sampler().begun(self.seed ^ salt, spp, width * height)

    def pixels(self, sampler: Any) -> tuple[Point2f, Point2f]:
        """The corners of pixels on the crop window, and places in each, spread evenly over [0, 1)^2: see `spread`."""
        lane = dr.arange(UInt32, sampler.wavefront_size())
        pixel = lane // dr.opaque(UInt32, self.spp)
        number = lane - pixel * self.spp
        row = pixel // dr.opaque(UInt32, self.window[0])
        place = hammersley(sampler, number, self.spp, lane - number)
        return Point2f(Float(pixel - row * self.window[0]), Float(row)), place

    def lens(self, sampler: Any) -> Any:
        """The camera, of one with a lens what is seen through a random point of it in each lane."""
        return self.camera.through_lens(sampler.next_2d()) if self.camera.needs_aperture_sample() else self.camera

    def first_vertices(self, camera: Any, sampler: Any, place: Point2f) -> Sequence[Any]:
        """What is seen at places on the crop window, in [0, 1)^2: all but media close to the camera, and these."""
        with dr.suspend_grad():
            ray = dr.detach(camera.ray_through(place, Point2f(0)))
            ray.medium = self.scene.camera_medium
            clear = CLOSE * float(self.scene.bounding_sphere()[1]) if self.in_medium else 0.0
            found = [FirstVertex.seen(self.integrator, self.scene, sampler, ray, True, clear, self.indirect)]
            if self.in_medium:
                start = dr.norm(ray.o - camera.origin) if camera.is_central else Float(clear)
                found.append(FirstVertex.close_by(self.integrator, self.scene, sampler, ray, dr.detach(start), clear))
            dr.eval(found)
            return found

    def image(self, place: Point2f, color: Color3f, lanes: int, active: Bool | bool = True) -> TensorXf:
        """The image of samples, some per pixel, at places on the crop window, in pixels."""
        width, height = self.window
        # Each pass has a share of the samples.
        weight = width * height / lanes * (self.spp / self.total)
        measured = color if self.camera.weight == 1 else color * self.camera.weight
        place = place + Point2f(self.camera.column, 0)
        return moving_samples(self.film, place, self.film.tangent_channels(measured), active, weight)


def within(samples: Samples) -> TensorXf:
    """The image of vertices that are seen in random places of the film."""
    sampler = samples.sampler(WITHIN_SEED, samples.spp)
    window = Point2f(samples.window)
    with dr.suspend_grad():
        corner, place = samples.pixels(sampler)
        place = (corner + place) / window
    camera = samples.lens(sampler)
    total = dr.zeros(TensorXf)
    for vertex in samples.first_vertices(camera, sampler, place):
        color, seen = vertex.attached(samples.scene, camera, sampler.next_1d())
        # Of a box the derivative is 0 within, and all at its border.
        moved = corner + 0.5 if samples.by_pixel else (place + (seen - dr.detach(seen))) * window
        total = total + samples.image(moved, color, sampler.wavefront_size())
    return total


def at_borders(samples: Samples) -> TensorXf:
    """The image of vertices at the border of the film, or of each pixel, which move in and out."""
    sampler = samples.sampler(BORDER_SEED, samples.spp if samples.by_pixel else -(-samples.spp // 4))
    lanes = sampler.wavefront_size()
    window = Point2f(samples.window)
    with dr.suspend_grad():
        # Left and right, upper and lower sides, one after the other.
        if samples.by_pixel:
            size = Point2f(1)
            corner, (around, _) = samples.pixels(sampler)
        else:
            size, corner = window, Point2f(0)
            around, _ = spread(sampler)
        perimeter = 2 * (size.x + size.y)
        around *= perimeter
        upright = around < 2 * size.y
        length = dr.select(upright, size.y, size.x)
        around -= dr.select(upright, 0, 2 * size.y)
        right_or_below = around >= length
        along = dr.minimum((around - dr.select(right_or_below, length, 0)) / length, BELOW_ONE)
        end, side = dr.select(right_or_below, Float(1), 0), dr.select(right_or_below, Float(1), -1)
        place = corner + size * dr.select(upright, Point2f(end, along), Point2f(along, end))
        outward = dr.select(upright, Point2f(side, 0), Point2f(0, side))
    camera = samples.lens(sampler)
    total = dr.zeros(TensorXf)
    for vertex in samples.first_vertices(camera, sampler, place / window):
        seen = place_on_film(camera, vertex.place(camera))
        leaving = dr.dot(window * (seen - dr.detach(seen)), outward)
        color = vertex.radiance * (leaving * (perimeter / (size.x * size.y)))
        if not samples.by_pixel:
            total = total + samples.image(place, -color, lanes)
            continue
        # What leaves a pixel comes into the next one, and their common side is chosen from both.
        middle = corner + 0.5
        beyond = middle + outward
        shared = (beyond.x > 0) & (beyond.y > 0) & (beyond.x < window.x) & (beyond.y < window.y)
        color *= dr.select(shared, 0.5, 1)
        total = total + samples.image(middle, -color, lanes) + samples.image(beyond, color, lanes, shared)
    return total


def at_near_plane(samples: Samples) -> TensorXf:
    """The image of vertices in a medium at the near plane of the camera, which moves over them."""
    if not samples.in_medium:
        return dr.zeros(TensorXf)
    sampler = samples.sampler(NEAR_SEED, -(-samples.spp // 4))
    camera = samples.lens(sampler)
    with dr.suspend_grad():
        place = sampler.next_2d()
        ray = dr.detach(camera.ray_through(place, Point2f(0)))
        ray.medium = samples.scene.camera_medium
        # A little ahead: at the plane itself, rounding decides whether a point is seen.
        t = AHEAD * (dr.norm(ray.o - camera.origin) if camera.is_central else Float(1))
        vertex = FirstVertex.at_distance(samples.integrator, samples.scene, sampler, ray, t)
        dr.eval(place, vertex)
    distance = camera.sample_wi(vertex.p, Point2f(0))[0].dist
    color = vertex.radiance * (distance - dr.detach(distance))
    return samples.image(place * Point2f(samples.window), color, sampler.wavefront_size())


def at_outlines(samples: Samples) -> TensorXf:
    """The image of vertices that outlines cover and uncover, and of seams of smooth meshes."""
    shapes = outlined(samples)
    total = dr.zeros(TensorXf)
    if not shapes:
        return total
    scene = samples.scene.replace(silhouettes_of=shapes)
    with_seams = any(turns_dark(shape) for shape in shapes)
    points = lens_points(samples.camera, samples.seed ^ LENS_SEED, samples.spp)
    for number, point in enumerate(points):
        camera = samples.camera.through_lens(point)
        with dr.suspend_grad():
            sampler = samples.sampler(OUTLINE_SEED - number, -(-samples.spp // len(points)))
            viewpoint = dr.detach(viewpoint_of(scene, camera))
            outlines = Outlines(shapes, viewpoint, with_seams=True)
            ss = outlines.sample(spread(sampler))
            active = ss.is_valid() & (ss.pdf > 0)
            it = dr.zeros(Interaction3f)
            it.p = ss.p
            ds, importance = dr.detach(camera.sample_wi(ss.p, Point2f(0)))
            start = ss.toward_viewer().spawn_ray().o
            sight = Ray3f(ds.p, start - ds.p, maxt=Float(1 - SHADOW_EPSILON), medium=scene.camera_medium)
            left, medium = way_through(scene, sampler, sight, active & (importance > 0))
            active &= (dr.max(left) > 0) & nothing_at(scene, ss, active)
            beyond = ss.spawn_ray()
            beyond.medium = medium
            paths, indirect = samples.integrator, samples.indirect
            back = FirstVertex.seen(paths, scene, sampler.clone(), beyond, active, indirect=indirect)
            front = None
            if with_seams:
                si, known = foreground(scene, shapes, ss, active)
                front = FirstVertex.on_surface(paths, scene, sampler, beyond, si, active & known, indirect)
            weight = dr.select(active, left / ss.pdf, 0)
            dr.eval(ss, active, weight, back, front, ds.uv)
        edge = change_on_film(camera, outlines.follow(ss, active, viewpoint_of(scene, camera)))
        color = Color3f(0)
        for vertex, sign in ((back, -1), (front, 1)):
            if vertex is not None:
                passing = edge - change_on_film(camera, vertex.place(camera))
                color += vertex.radiance * (sign * swept_area(camera, ss, passing))
        place = ds.uv * Point2f(samples.window)
        total = total + samples.image(place, color * weight, sampler.wavefront_size() * len(points), active)
    return total


def change_on_film(camera: Any, p: Any) -> Point2f:
    """The motion of points on the film, a unit square: 0, attached."""
    place = place_on_film(camera, p)
    return Point2f(place - dr.detach(place))


def outlined(samples: Samples) -> list[Any]:
    """The shapes that hide what is behind them."""
    return [
        shape
        for shape in samples.scene.silhouettes.outlined()
        if not (int(shape.bsdf().flags()) & int(BSDFFlags.Null))
        and not (samples.integrator.hide_emitters and shape.emitter() is not None)
    ]
