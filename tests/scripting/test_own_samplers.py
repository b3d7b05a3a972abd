"""Samplers of scripts, used by djpt's integrators: Mitsuba's images, gradients, and what is refused."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import RenderError
from djpt.jit.types import Color3f
from djpt.rendering.gradients import derivatives
from djpt.rendering.schedules import wavefront

RED = "red.reflectance.value"
SIZE = 12


def mixed(word: Any) -> Any:
    """A word whose bits are mixed: that of MurmurHash3 (A. Appleby)."""
    word = (word ^ (word >> 16)) * 0x85EBCA6B
    word = (word ^ (word >> 13)) * 0xC2B2AE35
    return word ^ (word >> 16)


def hashed(mi: Any) -> Any:
    """A class of samplers, as a script for Mitsuba would write it: a hashed counter per lane."""

    class Hashed(mi.Sampler):  # type: ignore[misc, name-defined]
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.state = mi.UInt32(0)

        def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
            super().seed(seed, wavefront_size)
            self.state = mixed(dr.arange(mi.UInt32, self.wavefront_size()) + mixed(mi.UInt32(seed) + 1))

        def next_1d(self, active: Any = True) -> Any:
            self.state = self.state + 0x9E3779B9
            return mi.Float(mixed(self.state) >> 8) * 2.0**-24

        def next_2d(self, active: Any = True) -> Any:
            x = self.next_1d(active)
            return mi.Point2f(x, self.next_1d(active))

        def fork(self) -> Any:
            other = Hashed(mi.Properties())
            other.set_sample_count(self.sample_count())
            return other

        def clone(self) -> Any:
            other = self.fork()
            if self.wavefront_size():
                other.seed(0, self.wavefront_size())
            other.state = mi.UInt32(self.state)
            return other

    return Hashed


djpt.register_sampler("hashed", lambda props: hashed(djpt)(props))


def room(mi: Any, integrator: str, rfilter: str = "box", sampler: str = "hashed", **settings: Any) -> Any:
    box = mi.cornell_box()
    box["sensor"]["film"].update(width=SIZE, height=SIZE, rfilter={"type": rfilter})
    box["sensor"]["sampler"] = {"type": sampler, "sample_count": 4}
    box["integrator"] = {"type": integrator, **settings}
    return mi.load_dict(box)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("integrator", ["path", "direct"])
def test_images_are_mitsubas(mi: Any, integrator: str, rfilter: str) -> None:
    mi.register_sampler("hashed", lambda props: hashed(mi)(props))
    mine, his = (np.array(m.render(room(m, integrator, rfilter), spp=8, seed=3)) for m in (djpt, mi))
    np.testing.assert_allclose(mine, his, rtol=1e-4, atol=1e-5)


@pytest.mark.sparse(3)
@pytest.mark.parametrize("integrator", ["path", "direct", "depth", "moment", "whitted"])
def test_images_are_those_of_any_sampler(integrator: str) -> None:
    """Those of `stratified`, say, within noise."""
    settings = {"inner": {"type": "direct"}} if integrator == "moment" else {}
    own, reference = (
        np.array(djpt.render(room(djpt, integrator, sampler=name, **settings), spp=256))
        for name in ("hashed", "stratified")
    )
    assert own.shape == reference.shape
    np.testing.assert_allclose(own[..., :3].mean(), reference[..., :3].mean(), rtol=0.03)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_images_are_made_of_several_wavefronts(monkeypatch: pytest.MonkeyPatch, rfilter: str) -> None:
    scene, whole = room(djpt, "depth", rfilter), wavefront.LANES
    once = np.array(djpt.render(scene, spp=64))
    monkeypatch.setattr(wavefront, "LANES", SIZE * SIZE * 20)
    steps: list[int] = []
    parts = np.array(djpt.render(scene, spp=64, progress=lambda done, total: steps.append(done)))
    assert steps == [SIZE * SIZE * k for k in (16, 32, 48, 64)] and whole >= 2**20
    assert not np.array_equal(once, parts)  # other numbers
    np.testing.assert_allclose(parts.mean(axis=(0, 1)), once.mean(axis=(0, 1)), rtol=0.01)
    np.testing.assert_array_equal(parts, np.array(djpt.render(scene, spp=64, pass_spp=3)))
    assert not np.array_equal(parts, np.array(djpt.render(scene, spp=64, seed=1)))


@pytest.mark.sparse(3)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("integrator", ["path", "prb_basic", "direct"])
def test_gradients(integrator: str, rfilter: str) -> None:
    """At one seed they are derivatives of the image itself."""
    scene = room(djpt, integrator, rfilter, **({} if integrator == "direct" else {"max_depth": 4}))
    params = djpt.traverse(scene)

    def image(color: Color3f) -> Any:
        params[RED] = color
        params.update()
        return djpt.render(scene, params, spp=16, seed=5, seed_grad=5)

    color = Color3f(0.5, 0.1, 0.1)
    dr.enable_grad(color)
    dr.backward(dr.mean(image(color).array))
    color_forward = Color3f(0.5, 0.1, 0.1)
    dr.enable_grad(color_forward)
    dr.set_grad(color_forward, Color3f(1, 0, 0))
    change = np.array(dr.forward_to(image(color_forward)))
    means = [np.array(image(Color3f(0.5 + h, 0.1, 0.1))).mean(dtype=np.float64) for h in (-0.02, 0.02)]
    assert change.mean() == pytest.approx(dr.grad(color).x[0], rel=1e-3)
    assert change.mean() == pytest.approx((means[1] - means[0]) / 0.04, rel=0.01)


class Halved(djpt.load_dict({"type": "independent"}).__class__):  # type: ignore[misc]
    """One of djpt's samplers, with other numbers."""

    def next_2d(self, active: Any = True) -> Any:
        return super().next_2d(active) * 0.5


def test_overridden_numbers_count() -> None:
    djpt.register_sampler("halved", lambda props: Halved(props))
    sampler = djpt.load_dict({"type": "halved"})
    assert not sampler.has_streams and djpt.load_dict({"type": "independent"}).has_streams
    scene = djpt.load_dict(
        {
            "type": "scene",
            "light": {"type": "constant"},
            "floor": {"type": "rectangle", "to_world": djpt.ScalarTransform4f().translate([1.0, 0, 0])},
            "sensor": {
                "type": "orthographic",
                "to_world": djpt.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
                "sampler": {"type": "halved"},
            },
            "integrator": {"type": "depth"},
        }
    )
    depth = np.array(djpt.render(scene, spp=16)).ravel()[0]
    assert depth in (0, pytest.approx(3))  # one half of the pixel alone


def test_what_is_refused() -> None:
    scene = room(djpt, "path")
    with pytest.raises(RenderError, match="next_1d and next_2d, but no 'stream' for each sample: use schedule='wave'"):
        djpt.render(scene, spp=1, schedule="flat")
    with pytest.raises(RenderError, match="which 'ParticleTracer' needs: use another integrator"):
        djpt.render(scene, integrator=djpt.load_dict({"type": "ptracer"}), spp=1)
    assert djpt.render(scene, spp=1, schedule="wave").shape == (SIZE, SIZE, 3)


def test_too_many_samples_for_a_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(derivatives, "MAX_ATTACHED_SAMPLES", SIZE * SIZE * 4)
    scene = room(djpt, "path")
    params = djpt.traverse(scene)
    dr.enable_grad(params[RED])
    params.update()
    with pytest.raises(RenderError, match="differentiated in one wavefront, because the sampler has no 'stream'"):
        djpt.render(scene, params, spp=5)
