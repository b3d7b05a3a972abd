"""What a BSDF of a user's own may keep in its attributes: arrays, numbers, textures, and what it doesn't report."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.jit.types import Color3f, Float, UInt32
from tests.kit.swatches import albedos, swatches


class Base(djpt.BSDF):
    """A diffuse material of the colour that `color` computes in the kernel."""

    def flags(self) -> Any:
        return djpt.BSDFFlags.DiffuseReflection | djpt.BSDFFlags.FrontSide

    def color(self, si: Any) -> Any:
        raise NotImplementedError

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        bs = djpt.BSDFSample3f(djpt.warp.square_to_cosine_hemisphere(sample2))
        bs.pdf, bs.sampled_type = bs.wo.z * dr.inv_pi, djpt.BSDFFlags.DiffuseReflection
        return bs, dr.select(si.wi.z > 0, self.color(si), 0)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return self.color(si) * self.pdf(ctx, si, wo, active)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        return dr.select((si.wi.z > 0) & (wo.z > 0), wo.z * dr.inv_pi, 0)


class Hidden(Base):
    """Keeps a Python number, a flag and an array, and reports nothing."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.scale = props.get("scale", 1.0)
        self.gray = props.get("gray", False)
        self.tint = props["tint"]

    def color(self, si: Any) -> Any:
        color = self.tint * self.scale
        return Color3f(dr.mean(color)) if self.gray else color


class Numeric(Base):
    """Reports a Python number, and derives another one from it."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.gamma = props["gamma"]
        self.parameters_changed([])

    def parameters_changed(self, keys: Any) -> None:
        self.bright = 0.5**self.gamma

    def color(self, si: Any) -> Any:
        return Color3f(self.bright)

    def traverse(self, callback: Any) -> None:
        callback.put_parameter("gamma", self.gamma)


class Wide(Base):
    """Keeps a palette and nested textures."""

    def __init__(self, props: Any) -> None:
        super().__init__(props)
        self.palette = Float(list(props.get("palette", (0.1, 0.9))))
        dr.make_opaque(self.palette)
        self.paint = props.get_texture("paint", 0.5)

    def color(self, si: Any) -> Any:
        left = dr.gather(Float, self.palette, dr.select(si.uv.x < 0.5, UInt32(0), UInt32(1)))
        return left * self.paint.eval(si)

    def traverse(self, callback: Any) -> None:
        callback.put_object("paint", self.paint, djpt.ParamFlags.Differentiable)
        callback.put("palette", self.palette, djpt.ParamFlags.Differentiable)


for kind in (Hidden, Numeric, Wide):
    djpt.register_bsdf(f"script_{kind.__name__.lower()}", kind)


def test_what_is_not_reported_sets_instances_apart() -> None:
    tint = [0.2, 0.4, 0.6]
    scene = swatches(
        a={"type": "script_hidden", "tint": tint},
        b={"type": "script_hidden", "tint": [0.9, 0.1, 0.5]},
        c={"type": "script_hidden", "tint": tint, "scale": 0.5},
        d={"type": "script_hidden", "tint": tint, "gray": True},
    )
    assert sorted(len(group.plugins) for group in scene.bsdfs.ensemble.groups) == [1, 1, 2]
    found = albedos(scene, a=0, b=0, c=0, d=0)
    expected = {"a": tint, "b": [0.9, 0.1, 0.5], "c": [0.1, 0.2, 0.3], "d": [0.4] * 3}
    for name, color in expected.items():
        np.testing.assert_allclose(found[name], color, rtol=1e-4, err_msg=name)
    # Arrays of a class without a traverse of its own are parameters.
    params = djpt.traverse(scene)
    assert {"a.bsdf.tint", "c.bsdf.tint"} <= set(params)
    params["c.bsdf.tint"] = [1, 1, 1]
    params.update()
    np.testing.assert_allclose(albedos(scene, a=0, b=0, c=0, d=0)["c"], 0.5, rtol=1e-4)


def test_reported_python_numbers_can_be_edited() -> None:
    scene = swatches(**{name: {"type": "script_numeric", "gamma": 1.0} for name in "abc"})
    params = djpt.traverse(scene)
    params["b.bsdf.gamma"] = 2.0
    params.update()
    found = albedos(scene, a=0, b=0, c=0)
    np.testing.assert_allclose([x[0] for x in found.values()], [0.5, 0.25, 0.5], rtol=1e-4)
    with pytest.raises(djpt.ParameterError, match="must be plain numbers"):
        params["a.bsdf.gamma"] = attached(1.0)


def attached(x: float) -> Float:
    value = Float(x)
    dr.enable_grad(value)
    return value


def test_arrays_and_nested_textures() -> None:
    white = {"type": "rgb", "value": [1.0, 0.5, 0.25]}
    scene = swatches(
        a={"type": "script_wide", "palette": (0.2, 0.2), "paint": white},
        b={"type": "script_wide", "palette": (0.8, 0.8), "paint": white},
    )
    found = albedos(scene, a=0, b=0)
    np.testing.assert_allclose(found["a"], [0.2, 0.1, 0.05], rtol=1e-4)
    np.testing.assert_allclose(found["b"], [0.8, 0.4, 0.2], rtol=1e-4)
    params = djpt.traverse(scene)
    params["b.bsdf.paint.value"] = 0.5
    params["a.bsdf.palette"] = [0.4, 0.4]
    params.update()
    found = albedos(scene, a=0, b=0)
    np.testing.assert_allclose(found["b"], 0.4, rtol=1e-4)
    np.testing.assert_allclose(found["a"], [0.4, 0.2, 0.1], rtol=1e-4)
    dr.enable_grad(params["a.bsdf.palette"])
    with pytest.raises(djpt.ParameterError, match="isn't differentiable"):
        params.update()
