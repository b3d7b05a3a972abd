"""An integrator of your own: the light of a white sky on the first surface, and its gradient.

    python examples/own_integrator.py [--out sky.png] [--size 256] [--spp 64]

The class says how light is estimated and nothing about derivatives: Dr.Jit differentiates its code.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
from typing import Any

import drjit as dr

KEY = "ball.bsdf.reflectance.value"


class SkyLight(djpt.Integrator):
    """L = integral of f cos V over the hemisphere, estimated by f cos V / p with p = cos / pi.

    V is 1 if nothing is hit within `distance` (default 2): with white materials, this is ambient occlusion.
    """

    def __init__(self, props: djpt.Properties) -> None:
        super().__init__(props)
        self.distance = props.float("distance", 2.0, low=0.0, low_open=True)

    def sample(self, scene: djpt.Scene, sampler: Any, ray: djpt.Ray3f, medium: Any = None, active: Any = True) -> Any:
        si = scene.ray_intersect(ray, active)
        hit = si.is_valid() & active

        # A direction by the cosine, on the side from which the surface is seen.
        wo = djpt.warp.square_to_cosine_hemisphere(sampler.next_2d())
        pdf = djpt.warp.square_to_cosine_hemisphere_pdf(wo)
        wo.z = dr.mulsign(wo.z, si.wi.z)

        # Visibility. Only materials depend on the parameters here, so the test needs no derivative.
        probe = si.spawn_ray(si.to_world(wo))
        probe.maxt = djpt.Float(self.distance)
        free = hit & (pdf > 0) & ~scene.ray_test(probe, hit)
        value = si.bsdf().eval(djpt.BSDFContext(), si, wo, hit)
        return dr.select(free, value / pdf, 0), hit, []


djpt.register_integrator("sky_light", SkyLight)


def gradient(scene: djpt.Scene, integrator: djpt.Integrator, spp: int) -> float:
    """The derivative of the image's mean by the green of the ball, by automatic differentiation."""
    params = djpt.traverse(scene)
    dr.enable_grad(params[KEY])
    params.update()
    # One seed for the image and its gradient: the same rays as in the finite difference.
    image = djpt.render(scene, params, integrator=integrator, spp=spp, seed=1, seed_grad=1)
    dr.backward(dr.mean(image, axis=None))
    return float(dr.grad(params[KEY]).y[0])


def difference(scene: djpt.Scene, integrator: djpt.Integrator, spp: int, step: float = 0.05) -> float:
    """The derivative of the image's mean by the green of the ball, from the difference of two renderings."""
    params = djpt.traverse(scene)
    color, means = djpt.Color3f(params[KEY]), list[float]()
    for sign in (1, -1):
        params[KEY] = color + djpt.Color3f(0, sign * step, 0)
        params.update()
        image = djpt.render(scene, integrator=integrator, spp=spp, seed=1)
        means.append(float(dr.mean(image, axis=None).numpy()))
    return (means[0] - means[1]) / (2 * step)


def main() -> None:
    """Write a picture, and print the derivative in two ways."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="sky.png")
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--spp", type=int, default=64)
    options = parser.parse_args()

    description = djpt.scenes.stage(size=options.size)
    integrator = djpt.load_dict({"type": "sky_light", "distance": 2.0})
    djpt.write(options.out, djpt.render(djpt.load_dict(description), integrator=integrator, spp=options.spp))

    by_ad = gradient(djpt.load_dict(description), integrator, options.spp)
    by_difference = difference(djpt.load_dict(description), integrator, options.spp)
    print(f"d brightness / d green: {by_ad:.6f} by differentiation, {by_difference:.6f} by finite differences")
    if abs(by_ad - by_difference) > 1e-3 * abs(by_difference):
        raise SystemExit("the two disagree")


if __name__ == "__main__":
    main()
