"""`find_nan` names what is planted: plugin, parameter, pixel and vertex, in images, losses and gradients."""

import math
from typing import Any, ClassVar

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.properties import Properties
from djpt.errors import ParameterError
from djpt.validation.nonfinite import find_nan
from tests.kit.faults import planted


class Poisoned(djpt.BSDF):
    """Diffuse, but for one fault. Parameters: `albedo` (texture), `power` (number), `fault` (a name)."""

    children = ("albedo",)
    values: ClassVar[dict[str, djpt.ParamFlags]] = {"power": djpt.ParamFlags.Differentiable}
    statics = ("fault",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.albedo = props.texture("albedo", 0.5, low=0.0, high=1.0)
        self.power = djpt.Float(props.float("power", 0.0))
        self.fault = props.string("fault", "none")

    def flags(self) -> Any:
        return djpt.BSDFFlags.DiffuseReflection | djpt.BSDFFlags.FrontSide

    def colour(self, si: Any, active: Any) -> Any:
        albedo = self.albedo.eval(si, active)
        if self.fault == "value":  # 0 / 0 at power 0
            albedo = albedo * (self.power / self.power)
        if self.fault == "derivative":  # that of a root at 0
            albedo = albedo + dr.sqrt(self.power)
        if self.fault == "derivative by a texel":
            albedo = dr.sqrt(albedo)
        return albedo

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        above = (si.wi.z > 0) & (wo.z > 0)
        return dr.select(above, self.colour(si, active) * (wo.z / math.pi), 0), dr.select(above, wo.z / math.pi, 0)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        wo = square_to_cosine_hemisphere(sample2)
        bs = djpt.BSDFSample3f.of(wo, wo.z / math.pi, djpt.BSDFFlags.DiffuseReflection)
        return bs, dr.select(si.wi.z > 0, self.colour(si, active), 0)


djpt.register_bsdf("poisoned", Poisoned)

SIZE = 8


def room(fault: str = "none", rfilter: str = "box", albedo: Any = 0.5, lamp: Any = 5.0) -> djpt.Scene:
    """A white floor, seen from above; the ball to the right of the middle is at fault."""
    T = djpt.ScalarTransform4f
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": rfilter}}
    return djpt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 4},
            "camera": {"type": "perspective", "to_world": T().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0]), "film": film},
            "floor": {"type": "rectangle", "to_world": T().scale(4), "bsdf": {"type": "diffuse", "id": "white"}},
            "ball": {
                "type": "sphere",
                "center": [-1, 1, 0.5],
                "radius": 0.4,
                "bsdf": {"type": "poisoned", "id": "bad", "fault": fault, "albedo": albedo},
            },
            "lamp": {
                "type": "sphere",
                "center": [0, 0, 12],
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lamp}},
            },
        }
    )


def test_all_is_finite() -> None:
    scene = room()
    keys = [key for key in djpt.traverse(scene) if key.endswith(("reflectance.value", "albedo.value", "power"))]
    assert len(keys) == 4
    assert find_nan(scene, keys, spp=2) is None
    with pytest.raises(ParameterError, match="unknown parameter"):
        find_nan(scene, "white.reflectence")


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(2)
def test_a_value_in_the_image(rfilter: str) -> None:
    scene = room("value", rfilter)
    image = np.array(djpt.render(scene, spp=4))
    found = find_nan(scene, spp=4)
    assert found is not None and found.where == "image" and math.isnan(found.value)
    assert found.plugin == "bad" and found.parameter is not None and found.parameter.endswith("power")
    assert found.pixel is not None and not np.isfinite(image[found.pixel[1], found.pixel[0]]).all()
    assert found.vertex in (0, 1) and found.sample in range(4)
    assert "plugin 'bad'" in str(found)
    # The change that found the parameter was taken back.
    assert np.array(djpt.traverse(scene)[found.parameter]).item() == 0


def test_a_light_whose_samples_are_infinite() -> None:
    with planted("djpt.emitters.area:Area.sample_direction", "self.radiance.eval(ds, active) * weight", "weight / 0"):
        scene = room()
        found = find_nan(scene, spp=4)
    assert found is not None and found.where == "image" and found.quantity == "the light sample"
    assert found.plugin == scene.emitters()[0].id() and found.vertex == 0


@pytest.mark.parametrize("fault", ["derivative", "derivative by a texel"])
@pytest.mark.sparse(2)
def test_a_derivative(fault: str) -> None:
    texels = np.zeros((2, 2, 3), np.float32)
    bitmap = {"type": "bitmap", "data": texels, "raw": True}
    scene = room(fault, albedo=bitmap if "texel" in fault else 0.5)
    params = djpt.traverse(scene)
    wanted = next(key for key in params if key.endswith("albedo.data" if "texel" in fault else "power"))
    other = next(key for key in params if key.endswith("reflectance.value"))
    found = find_nan(scene, [other, wanted], spp=4)
    assert found is not None and found.where == "gradient" and found.parameter == wanted
    assert found.vertex in (0, 1, 2) and found.sample in range(4) and found.pixel is not None
    assert find_nan(scene, [other], spp=4) is None
    assert not dr.grad_enabled(params[wanted])


def test_the_loss() -> None:
    scene = room()
    key = next(key for key in djpt.traverse(scene) if key.endswith("reflectance.value"))
    found = find_nan(scene, key, spp=2, loss=lambda image: dr.sum(dr.log(image - dr.detach(image)), axis=None))
    assert found is not None and found.where == "loss" and found.pixel == (0, 0)


def test_other_integrators_name_pixel_and_parameter() -> None:
    found = find_nan(room("value"), spp=2, integrator=djpt.load_dict({"type": "direct"}))
    assert found is not None and found.pixel is not None
