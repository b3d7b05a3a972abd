"""Find a camera's pose and focal length from one picture that it took.

The scene is known, the camera isn't: the search starts 22 degrees and a third of the distance away, with a field of
view that is too wide. Each step renders the picture and its derivatives by seven numbers: the way and the turn of the
camera in its own space, and its focal length. Damped least squares (Levenberg 1944, Marquardt 1963) then says where to
go. Pictures are blurred, at first by an eighth of their width: what is far from its place still has a slope towards it.

    python examples/pose.py --out pose.png

writes the picture from the start, the one from the camera that was found, and the given one.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import drjit as dr
import numpy as np

T = djpt.ScalarTransform4f
CENTER = np.array([0.0, 0.0, 0.4])
BLURS = (*[1 / 8] * 3, *[1 / 16] * 2, *[1 / 32] * 2, *[1 / 64] * 3, *[1 / 128] * 3)
"""The standard deviation of the blur in each step, in widths of the picture."""


class Camera(NamedTuple):
    """A pose, a rigid transform (4, 4) from the camera to the world, and the horizontal field of view in degrees."""

    pose: Any
    fov: float

    def moved(self, change: Any) -> Camera:
        """The camera after a change: the way (3,) and the turn (3,), in its own space, and that of log(focal length).

        The way is in units of the distance from the centre of the scene.
        """
        way = np.asarray(change[:3]) * self.distance()
        turns = T().rotate([1, 0, 0], math.degrees(change[3])).rotate([0, 1, 0], math.degrees(change[4]))
        own = T().translate(way.tolist()) @ turns.rotate([0, 0, 1], math.degrees(change[5]))
        half = math.tan(math.radians(self.fov) / 2) * math.exp(-change[6])
        return Camera(self.pose @ own.matrix, 2 * math.degrees(math.atan(half)))

    def distance(self) -> float:
        """The distance from the centre of the scene."""
        return float(np.linalg.norm(self.pose[:3, 3] - CENTER))

    def errors(self, truth: Camera) -> tuple[float, float, float]:
        """The angle to the true pose in degrees, and the relative errors of the place and the focal length."""
        turn = self.pose[:3, :3].T @ truth.pose[:3, :3]
        angle = math.degrees(2 * math.asin(min(np.linalg.norm(turn - np.eye(3)) / math.sqrt(8), 1)))
        way = float(np.linalg.norm(self.pose[:3, 3] - truth.pose[:3, 3])) / truth.distance()
        lengths = (math.tan(math.radians(camera.fov) / 2) for camera in (truth, self))
        return angle, way, abs(next(lengths) / next(lengths) - 1)


def orbiting(azimuth: float, elevation: float, distance: float, fov: float) -> Camera:
    """A camera that looks at the centre of the scene, from angles in degrees."""
    a, e = math.radians(azimuth), math.radians(elevation)
    way = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
    pose = T().look_at((CENTER + distance * way).tolist(), CENTER.tolist(), [0, 0, 1])
    return Camera(pose.matrix, fov)


TRUTH = orbiting(30, 35, 6.0, 32.0)
START = orbiting(49, 23, 8.0, 38.0)


def load(size: int) -> djpt.Scene:
    """Balls on a painted floor, in the light of a sky and a lamp."""
    paint = 0.1 + 0.8 * np.random.default_rng(4).random((12, 12, 3), np.float32)
    picture = {"type": "bitmap", "data": djpt.TensorXf(paint), "raw": True}
    balls = {
        f"ball{k}": {
            "type": "sphere",
            "center": [x, y, radius],
            "radius": radius,
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": color}},
        }
        for k, (x, y, radius, color) in enumerate(
            [(0.8, 0.3, 0.6, [0.8, 0.2, 0.1]), (-0.7, 0.8, 0.45, [0.1, 0.3, 0.8]), (-0.2, -0.9, 0.7, [0.8, 0.7, 0.2])]
        )
    }
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb", "rfilter": {"type": "box"}}
    return djpt.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "film": film},
            "floor": {
                "type": "rectangle",
                "to_world": T().scale(2.2),
                "bsdf": {"type": "diffuse", "reflectance": picture},
            },
            "sky": {"type": "constant", "radiance": 0.5},
            "lamp": {"type": "point", "position": [2.0, -1.0, 5.0], "intensity": 30.0},
            **balls,
        }
    )


def aim(params: djpt.SceneParameters, camera: Camera, change: djpt.Float | None = None) -> None:
    """Place the camera of a scene, attached to a `change` of it that is 0, (7,), if there is one."""
    pose, fov = djpt.Transform4f(T(camera.pose)), djpt.Float(camera.fov)
    if change is not None:
        c = [dr.gather(djpt.Float, change, djpt.UInt32(k)) for k in range(7)]
        pose = pose @ djpt.Transform4f().translate([camera.distance() * x for x in c[:3]])
        for axis, turn in zip(np.eye(3).tolist(), c[3:6], strict=True):
            pose = pose @ djpt.Transform4f().rotate(axis, turn * (180 / math.pi))
        half = math.tan(math.radians(camera.fov) / 2) * dr.exp(-c[6])
        fov = dr.atan(half) * (360 / math.pi)
    params["sensor.to_world"], params["sensor.x_fov"] = pose, fov
    params.update()


def search(
    scene: djpt.Scene,
    target: Any,
    start: Camera,
    *,
    blurs: tuple[float, ...] = BLURS,
    spp: int = 8,
    report: Callable[[int, float, Camera], None] | None = None,
) -> Camera:
    """Find the camera that took a picture.

    Args:
        scene: The scene, whose camera is moved.
        target: The picture, (H, W, 3), linear.
        start: The camera to start from.
        blurs: The blur of each step, in widths of the picture.
        spp: Samples per pixel of each picture and derivative; four times as many for pictures of the last steps.
        report: Called with the number of each step, its loss and the camera.
    """
    params, camera = djpt.traverse(scene), start
    # A step needs the slope of the picture, not its last digit: how shadows of the sky move is left out.
    slopes = djpt.load_dict({"type": "direct_projective", "sppi": 0})
    path = djpt.load_dict({"type": "direct"})

    def residual(camera: Camera, sigma: float, seed: int) -> Any:
        aim(params, camera)
        image = djpt.render(scene, params, integrator=path, spp=4 * spp if sigma < 2 else spp, seed=seed)
        return blurred(np.array(image) - target, sigma)

    damping = 1e-3
    for step, blur in enumerate(blurs):
        sigma = blur * target.shape[1]
        now = residual(camera, sigma, step)
        columns = []
        for k in range(7):
            change = djpt.Float(np.zeros(7, np.float32))
            dr.enable_grad(change)
            dr.set_grad(change, djpt.Float(np.eye(7, dtype=np.float32)[k]))
            aim(params, camera, change)
            slope = slopes.render_forward(scene, params, spp=spp, seed=1000 + step)
            columns.append(blurred(np.array(slope), sigma).ravel())
        jacobian = np.array(columns, np.float64)
        normal, slope = jacobian @ jacobian.T, jacobian @ now.ravel()
        for _ in range(6):
            way = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            moved = camera.moved(way)
            if np.square(residual(moved, sigma, step)).sum() < np.square(now).sum():
                camera, damping = moved, damping / 10
                break
            damping *= 10
        if report is not None:
            report(step + 1, float(np.square(now).mean()), camera)
    return camera


def blurred(image: Any, sigma: float) -> Any:
    """A square image (N, N, C) after a Gaussian filter whose standard deviation is `sigma` pixels."""
    if sigma == 0:
        return image
    place = np.arange(len(image))
    weights = np.exp(-0.5 * np.square((place[:, None] - place) / sigma))
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("ij,jkc,lk->ilc", weights, image, weights, optimize=True)


def picture(scene: djpt.Scene, camera: Camera, spp: int = 256) -> Any:
    """What a camera sees, (H, W, 3)."""
    params = djpt.traverse(scene)
    aim(params, camera)
    return np.array(djpt.render(scene, params, integrator=djpt.load_dict({"type": "direct"}), spp=spp, seed=2**20))


def main() -> None:
    """Take a picture, forget the camera, find it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("pose.png"), help="picture to write")
    parser.add_argument("--size", type=int, default=128, help="width and height in pixels")
    parser.add_argument("--spp", type=int, default=8, help="samples per pixel of a step")
    arguments = parser.parse_args()

    scene = load(arguments.size)
    target = picture(scene, TRUTH, 1024)

    def report(step: int, loss: float, camera: Camera) -> None:
        angle, way, length = camera.errors(TRUTH)
        print(f"{step:4d}{loss:12.3e}{angle:12.3f}{way:12.3%}{length:14.3%}")

    print("step        loss       angle       place  focal length")
    report(0, math.nan, START)
    begin = time.perf_counter()
    found = search(scene, target, START, spp=arguments.spp, report=report)
    print(f"{time.perf_counter() - begin:.1f} s")
    panels = [picture(scene, camera) for camera in (START, found)] + [target]
    djpt.write(arguments.out, np.concatenate(panels, axis=1))
    print(f"{arguments.out}: start, found, given")


if __name__ == "__main__":
    main()
