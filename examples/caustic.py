"""Find a glass ball by its caustic.

The picture shows a white floor with the light that a ball of glass gathers on it, and not the ball, which hangs above.
The place of the caustic and its size say where the ball is: it moves along with the ball, and it is smallest where the
floor is at the focus.

Paths from the camera hardly find the way through the ball to the sun. Paths from the sun do, so the script traces
light, as `ptracer` does, by code whose derivatives Dr.Jit knows. With L the light of a floor without the ball, the
picture is

    L - (light that would fall on the ball, on the floor behind it) + (the same light, wherever the ball sends it).

The sun's rays of both sums start on a disk in front of the ball, and move with it. So each ray hits the ball at the
same place, and all that follows changes continuously: there are no outlines, whose derivatives would need samples of
their own, and no rays that begin to graze the ball, whose refraction would turn infinitely fast. On the film, light is
spread by a filter; its slope is the derivative by the place.

    python examples/caustic.py --out caustic.png

writes the picture with the ball where the search starts, with the one that was found, and the given one.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import drjit as dr
import numpy as np
from drjit.opt import Adam

T = djpt.ScalarTransform4f
KEY = "ball.to_world"
INDEX, RADIUS = 1.5, 0.5
SUN = (1.4, 0.2, -1.0)
"""The direction of its rays."""
TRUTH, START = (-1.0, -0.1, 0.65), (-1.35, -0.5, 0.95)
BLUR = 0.2
"""The standard deviation of the first blur, in widths of the picture."""
DEPTH = 5
"""The number of surfaces that a ray meets at most."""


def load(size: int) -> djpt.Scene:
    """A floor that the camera looks at from above, and a ball of glass at its true place, out of the picture.

    The film has `size` + 2 pixels along each axis: see `inner`.
    """
    size += 2
    # The weights of a tent add up to 1 wherever light arrives, which so moves from pixel to pixel without a loss.
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "tent"}}
    place = T().look_at([2.2, -0.6, 2.2], [0.4, 0, 0], [0, 1, 0])
    return djpt.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 34, "to_world": place, "film": film},
            "white": {"type": "diffuse", "reflectance": 1.0},
            "floor": {"type": "rectangle", "to_world": T().scale(3), "bsdf": {"type": "ref", "id": "white"}},
            "ball": {
                "type": "sphere",
                "to_world": T().translate(list(TRUTH)).scale(RADIUS),
                "bsdf": {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0},
            },
            "sun": {"type": "directional", "direction": list(SUN), "irradiance": 1.0},
        }
    )


def trace(scene: djpt.Scene, center: Any, spp: int, seed: int) -> djpt.TensorXf:
    """The `inner` picture of the floor in the light of the sun, attached to the place of the ball.

    The scene's ball is at `center`; `spp` rays per pixel fall on it.
    """
    film = scene.sensors()[0].film()
    width, height = film.crop_size()
    rays = width * height * spp
    random = djpt.load_dict({"type": "independent"})
    random.seed(seed, rays)

    down = dr.normalize(djpt.Vector3f(*SUN))
    disk = RADIUS * djpt.warp.square_to_uniform_disk_concentric(random.next_2d())
    o = center + djpt.Frame3f(down).to_world(djpt.Vector3f(disk.x, disk.y, -2))
    ray = djpt.Ray3f(djpt.Point3f(o), djpt.Vector3f(down))
    # Each ray carries its part of the flux, and a pixel has its part of the film.
    flux = djpt.Float(np.pi * RADIUS**2 / spp)
    film.prepare([])
    block = film.create_block(normalize=True)
    behind = o - down * (o.z / down.z)
    show(scene, block, behind, -flux, djpt.Bool(True))

    place, inside, shown = djpt.Point3f(behind), djpt.Bool(True), djpt.Bool(False)
    for _ in range(DEPTH):
        si = scene.ray_intersect(ray, inside)
        inside = inside & si.is_valid()
        # The floor is at z = 0.
        on_floor = inside & (dr.abs(si.p.z) < 1e-4)
        place = dr.select(on_floor, si.p, place)
        shown, inside = shown | on_floor, inside & ~on_floor
        # The cosine towards the side that the ray comes from, and Fresnel's equations. Angles don't change.
        n = si.n
        cosine = dr.detach(-dr.dot(n, ray.d))
        reflected, cos_t, _, eta_ti = djpt.fresnel(cosine, djpt.Float(INDEX))
        mirrored = random.next_1d() <= reflected
        d = dr.select(mirrored, ray.d + 2 * cosine * n, ray.d * eta_ti + n * (cosine * eta_ti + cos_t))
        ray = djpt.Ray3f(si.p + 1e-4 * dr.detach(d), dr.normalize(d))
    show(scene, block, place, flux, shown)
    film.put_block(block)
    # The floor is white: 1 / pi of what arrives goes in each direction.
    return inner(film.develop()) - down.z / np.pi


def inner(image: djpt.TensorXf) -> djpt.TensorXf:
    """A picture without its outermost pixels, which what leaves the film jumps from."""
    return image[1:-1, 1:-1, :]


def show(scene: djpt.Scene, block: Any, p: Any, flux: Any, active: Any) -> None:
    """Add the light of points of the floor to a picture, given the flux that arrives there."""
    seen = djpt.Interaction3f(0, 0, [], p)
    ds, importance = scene.sensors()[0].sample_direction(seen, djpt.Point2f(0), active)
    light = flux / np.pi * dr.abs(ds.d.z) * importance.x
    block.put(ds.uv, [light, light, light, djpt.Float(0)], active)


def search(
    scene: djpt.Scene,
    target: djpt.TensorXf,
    start: tuple[float, float, float],
    *,
    steps: int = 100,
    spp: int = 16,
    rate: float = 0.06,
    report: Callable[[int, float, Any], None] | None = None,
) -> Any:
    """Find the place of the ball's centre, (3,), from a picture.

    Args:
        scene: The scene, whose ball is moved.
        target: The picture, (H, W, 3), linear.
        start: The place to start from.
        steps: Steps of Adam.
        spp: Rays per pixel of each picture.
        rate: The length of the first steps. It shrinks to a fiftieth, so that noise averages out.
        report: Called with the number and the loss of each step, and the place.
    """
    params = djpt.traverse(scene)
    optimizer = Adam(lr=rate, params={"center": djpt.Point3f(*start)})
    for step in range(steps):
        optimizer.set_learning_rate(rate * 0.02 ** (step / steps))
        center = optimizer["center"]
        params[KEY] = djpt.Transform4f().translate(center).scale(RADIUS)
        params.update()
        image = trace(scene, center, spp, step)
        blur = blurring(len(target), BLUR * len(target) * (1 - step / steps) ** 2)
        difference = np.einsum("ij,jkc,lk->ilc", blur, np.array(dr.detach(image) - target), blur, optimize=True)
        # The loss is half the sum of the squares; its derivative by the pixels is blurred once more.
        slope = np.einsum("ij,ilc,lk->jkc", blur, difference, blur, optimize=True)
        dr.backward(dr.sum(image * djpt.TensorXf(slope.astype(np.float32)), axis=None))
        optimizer.step()
        if report is not None:
            report(step, float(np.square(difference).mean()), place_of(optimizer["center"]))
    found = place_of(optimizer["center"])
    params[KEY] = T().translate(found.tolist()).scale(RADIUS)
    params.update()
    return found


def blurring(size: int, sigma: float) -> Any:
    """The matrix (size, size) of a Gaussian filter whose standard deviation is `sigma` pixels."""
    place = np.arange(size)
    weights = np.exp(-0.5 * np.square((place[:, None] - place) / (sigma + 1e-3)))
    return weights / weights.sum(axis=1, keepdims=True)


def place_of(point: Any) -> Any:
    """A point as a NumPy array, (3,)."""
    return np.array(dr.detach(point)).ravel()


def main() -> None:
    """Take a picture, forget where the ball was, find it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("caustic.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=64, help="width and height in pixels")
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--spp", type=int, default=16, help="rays per pixel of a step")
    arguments = parser.parse_args()

    scene = load(arguments.size)
    params = djpt.traverse(scene)
    tracer = djpt.load_dict({"type": "ptracer"})
    target = inner(djpt.render(scene, spp=1024, seed=2**20, integrator=tracer))
    params[KEY] = T().translate(list(START)).scale(RADIUS)
    params.update()
    before = inner(djpt.render(scene, spp=1024, integrator=tracer))

    def report(step: int, loss: float, place: Any) -> None:
        if step % 10 == 0 or step == arguments.steps - 1:
            print(f"step {step:4d}   loss {loss:.2e}   off by {np.linalg.norm(place - TRUTH):.4f}")

    begin = time.perf_counter()
    found = search(scene, target, START, steps=arguments.steps, spp=arguments.spp, report=report)
    print(f"{time.perf_counter() - begin:.1f} s; the ball is at {np.round(found, 3)}, found; {TRUTH}, true")
    after = inner(djpt.render(scene, spp=1024, integrator=tracer))
    djpt.write(arguments.out, np.concatenate([np.array(i) for i in (before, after, target)], axis=1))
    print(f"{arguments.out}: start, found, given")


if __name__ == "__main__":
    main()
