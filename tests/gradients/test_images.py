"""Derivatives of images: against finite differences of the same samples, and against Mitsuba's prb.

The same seed for image and gradient makes both see the same paths. Light transport is a
polynomial in reflectances, so central differences of float32 images are good to about 1e-3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest
from numpy.typing import NDArray

import djpt
from djpt.integrators import Integrator
from djpt.rendering.gradients import leaves as replay
from tests.kit.derivatives import ALBEDO, RADIANCE, SEED, Experiment
from tests.kit.renders import box, lights, pixels, theirs, two_sided

PRB = {"type": "prb", "max_depth": 5, "rr_depth": 1000}
PLAIN = {"type": "plain_direct"}


class PlainDirect(Integrator):
    """What a user may write: emission and one light sample, differentiable as any Dr.Jit code."""

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        si = scene.ray_intersect(ray, active)
        result = si.emitter(scene).eval(si, active)
        hit = si.is_valid() & active
        ds, light = scene.sample_emitter_direction(si, sampler.next_2d(hit), True, hit)
        value = si.bsdf().eval(djpt.BSDFContext(), si, si.to_local(ds.d), hit)
        return result + value * light, hit, []


djpt.register_integrator("plain_direct", PlainDirect)


# ---------------------------------------------------------------- parameters


@pytest.mark.sparse(6)
@pytest.mark.parametrize("integrator", ["prb", "path"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_albedo_and_radiance(rfilter: str, integrator: str) -> None:
    description = box(16, rfilter, {**PRB, "type": integrator})
    Experiment(description, [ALBEDO, "white.reflectance.value", RADIANCE]).check()


@pytest.mark.sparse(20)
@pytest.mark.parametrize("integrator", [PRB, {"type": "direct"}, PLAIN], ids=["prb", "direct", "plain"])
@pytest.mark.parametrize(
    ("light", "name"),
    [("point", "point.intensity.value"), ("sky", "sky.radiance.value"), ("ball", "ball.emitter.radiance.value"),
     ("block", "block.emitter.radiance.value")],
)  # fmt: skip
def test_lights(light: str, name: str, integrator: dict[str, Any]) -> None:
    def edit(scene: dict[str, Any]) -> None:
        lights(light)(scene)
        node = scene[light]
        key = "intensity" if light == "point" else "radiance"
        node.get("emitter", node)[key] = {"type": "rgb", "value": [0.5, 1.0, 0.2]}

    Experiment(box(16, "box", integrator, edit), [name, RADIANCE]).check()


@pytest.mark.sparse(10)
@pytest.mark.parametrize("integrator", [{"type": "direct"}, {"type": "direct", "shading_samples": 2}, PLAIN], ids=str)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_plain_automatic_differentiation(rfilter: str, integrator: dict[str, Any]) -> None:
    Experiment(box(16, rfilter, integrator), [ALBEDO, "white.reflectance.value", RADIANCE]).check()


def test_roulette_does_not_matter_to_reverse_and_forward() -> None:
    """Its decisions depend on the albedos, so finite differences jump; the two modes still agree."""
    experiment = Experiment(box(16, "box", {"type": "prb", "max_depth": 12, "rr_depth": 2}), [ALBEDO])
    experiment.assert_modes_agree()


def test_zero_albedo() -> None:
    """At black the weight vanishes; light sampling still has a derivative, and nothing is NaN."""

    def edit(scene: dict[str, Any]) -> None:
        scene["red"]["reflectance"]["value"] = [0.0, 0.0, 0.3]

    gradient = Experiment(box(16, "box", PRB, edit), [ALBEDO]).gradients()[ALBEDO]
    assert np.isfinite(gradient).all()
    assert (gradient > 0).all()


# ---------------------------------------------------------------- films


@pytest.mark.sparse(6)
@pytest.mark.parametrize("pixel_format", ["rgba", "luminance"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_pixel_formats(rfilter: str, pixel_format: str) -> None:
    Experiment(box(12, rfilter, PRB, pixel_format=pixel_format), [ALBEDO, RADIANCE]).check()


@pytest.mark.sparse(3)
@pytest.mark.parametrize("rfilter", ["tent", "mitchell", "lanczos", "catmullrom"])
def test_filters(rfilter: str) -> None:
    Experiment(box(12, rfilter, PRB), [ALBEDO]).check()


@pytest.mark.parametrize("integrator", [PRB, PLAIN], ids=["prb", "plain"])
@pytest.mark.sparse(2)
def test_crop_and_border(integrator: dict[str, Any]) -> None:
    film = {"crop_width": 9, "crop_height": 7, "crop_offset_x": 2, "crop_offset_y": 5, "sample_border": True}
    Experiment(box(16, "gaussian", integrator, **film), [ALBEDO, "white.reflectance.value"]).check()


@pytest.mark.parametrize("rfilter", [pytest.param("box", marks=pytest.mark.slow), "gaussian"])
def test_many_passes(rfilter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Passes over samples and bands leave the gradient as it is."""
    from djpt.rendering.schedules import passes

    names = [ALBEDO, RADIANCE]
    whole = Experiment(box(16, rfilter, PRB), names).gradients()
    monkeypatch.setattr(passes, "PASS_SAMPLES", 3 * 256)
    monkeypatch.setattr(passes, "STORED_SAMPLES", 3 * 256)
    monkeypatch.setattr(passes, "STORED_PIXELS", (7 * 16, 7 * 16))
    split = Experiment(box(16, rfilter, PRB), names)
    for name, gradient in split.gradients().items():
        np.testing.assert_allclose(gradient, whole[name], rtol=1e-5)
    split.check()


def test_samples_of_its_own() -> None:
    """`spp_grad` and `seed_grad`: another estimate of the same derivative."""
    description = box(16, "box", PRB)
    a = Experiment(description, [ALBEDO], spp=512).gradients()[ALBEDO]
    b = Experiment(description, [ALBEDO], spp=4, spp_grad=512, seed_grad=99).gradients()[ALBEDO]
    np.testing.assert_allclose(a, b, rtol=0.05)
    assert not np.array_equal(a, b)


# ---------------------------------------------------------------- structure of the scene


def test_two_sided_materials() -> None:
    def edit(scene: dict[str, Any]) -> None:
        two_sided(scene)
        for side in ("front", "back"):
            node = scene["small-sphere"]["bsdf"][side]
            node["reflectance"] = {"type": "rgb", "value": [node["reflectance"]] * 3}

    description = box(16, "box", PRB, edit)
    params = djpt.traverse(djpt.load_dict(description))
    nested = [name for name in params if "brdf" in name and name.endswith("reflectance.value")]
    assert len(nested) == 4
    Experiment(description, [*nested, "white.reflectance.value"]).check()


def test_shared_material_gathers_all_its_surfaces() -> None:
    """One shared white: its gradient is the sum of those of equal materials for each surface."""
    shared = Experiment(box(16, "box", PRB), ["white.reflectance.value"]).gradients()

    def split(scene: dict[str, Any]) -> None:
        for node in list(scene.values()):
            if isinstance(node, dict) and node.get("bsdf") == {"type": "ref", "id": "white"}:
                node["bsdf"] = scene["white"]

    description = box(16, "box", PRB, split)
    params = djpt.traverse(djpt.load_dict(description))
    names = [name for name in params if name.endswith("bsdf.reflectance.value")]
    assert len(names) == 6
    parts = Experiment(description, names).gradients()
    np.testing.assert_allclose(sum(parts.values()), shared["white.reflectance.value"], rtol=1e-5)


def tiles(scene: dict[str, Any]) -> list[str]:
    """A floor of 25 tiles, each of its own colour; returns their parameters."""
    del scene["floor"]
    colors = np.random.default_rng(0).uniform(0.2, 0.9, (25, 3))
    for i, color in enumerate(colors):
        at = [(2 * (i % 5) + 1) / 5 - 1, -1, (2 * (i // 5) + 1) / 5 - 1]
        place = djpt.ScalarTransform4f().translate(at).rotate([1, 0, 0], -90).scale(1 / 5)
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": color.tolist()}}
        scene[f"tile{i}"] = {"type": "rectangle", "to_world": place, "bsdf": bsdf}
    return [f"tile{i}.bsdf.reflectance.value" for i in range(25)]


def two_colors_each(scene: dict[str, Any]) -> list[str]:
    """Another colour on each side of every surface, and the lamp: 17 parameters of 8 shapes."""
    rng, names = np.random.default_rng(0), [RADIANCE]
    for key, node in scene.items():
        if isinstance(node, dict) and "bsdf" in node:
            colors = rng.uniform(0.2, 0.9, (2, 3)).tolist()
            front, back = ({"type": "diffuse", "reflectance": {"type": "rgb", "value": c}} for c in colors)
            node["bsdf"] = {"type": "twosided", "front": front, "back": back}
            names += [f"{key}.bsdf.brdf_{side}.reflectance.value" for side in range(2)]
    return names


@pytest.mark.sparse(6)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("edit", [two_colors_each, tiles])
def test_more_parameters_than_registers(edit: Callable[[Any], list[str]], rfilter: str) -> None:
    description = box(16, rfilter, PRB)
    names = edit(description)
    experiment = Experiment(description, names, spp=8)
    reverse = experiment.gradients()
    scale = max(np.abs(g).max() for g in reverse.values())
    assert len(names) > 16
    for name in names[::7]:
        changes = experiment.changes(name, 1)
        forward, slope = (experiment.value(change) for change in changes)
        assert reverse[name][1] == pytest.approx(slope, rel=3e-3, abs=3e-3 * scale)
        assert forward == pytest.approx(reverse[name][1], rel=1e-3, abs=1e-5 * scale)


def test_editing_between_image_and_gradient() -> None:
    """The derivative is that of the image that was rendered, whatever happens to the scene before it is asked for."""
    experiment = Experiment(box(16, "box", PRB), [ALBEDO])
    expected = experiment.gradients()[ALBEDO]
    (attached,), loss = experiment.attach(), experiment.attached(SEED)
    experiment.params["white.reflectance.value"] = djpt.Color3f(0.1)
    experiment.params[ALBEDO] = djpt.Color3f(0.9)
    experiment.params.update()
    dr.backward(loss)
    np.testing.assert_allclose(np.array(dr.grad(attached)).ravel(), expected, rtol=1e-5)


def gradient_by_albedo(image: Callable[[Any], Any]) -> NDArray[np.float32]:
    """The gradient of the sum of an image of the Cornell box by the white reflectance."""
    scene = djpt.load_dict(box())
    params = djpt.traverse(scene)
    dr.enable_grad(params["white.reflectance.value"])
    params.update()
    dr.backward(dr.sum(image(scene), axis=None))
    return np.array(dr.grad(params["white.reflectance.value"]))


def test_images_of_an_integrator_itself_are_attached() -> None:
    """Their derivatives are by the samples of the image: as those of a rendering with the same two seeds."""
    path = djpt.load_dict({"type": "path", "max_depth": 3})
    itself = gradient_by_albedo(lambda scene: path.render(scene, seed=5, spp=4))
    np.testing.assert_array_equal(
        itself, gradient_by_albedo(lambda scene: djpt.render(scene, integrator=path, seed=5, seed_grad=5, spp=4))
    )
    assert itself.min() > 0


def test_derivatives_do_not_depend_on_flags_of_dr_jit() -> None:
    """Scripts may ask for loops that are unrolled."""

    def image(scene: Any) -> Any:
        return djpt.render(scene, seed=1, spp=32)

    expected = gradient_by_albedo(image)
    with dr.scoped_set_flag(dr.JitFlag.SymbolicLoops, False):
        np.testing.assert_array_equal(gradient_by_albedo(image), expected)


def test_nothing_attached_gives_a_plain_image() -> None:
    image = djpt.render(djpt.load_dict(box(8, "box", PRB)), spp=2)
    assert not dr.grad_enabled(image)


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_attached_image_is_the_image(rfilter: str) -> None:
    experiment = Experiment(box(16, rfilter, PRB), [ALBEDO])
    plain = experiment.image(SEED)
    experiment.attach()
    image = djpt.render(experiment.scene, experiment.params, seed=SEED, **experiment.options)
    assert dr.grad_enabled(image)
    np.testing.assert_array_equal(pixels(dr.detach(image)), plain)


def test_descending_the_gradient_finds_the_albedo() -> None:
    """An optimiser of Dr.Jit, as in a script."""
    from drjit.opt import Adam

    scene = djpt.load_dict(box(16, "box", {**PRB, "max_depth": 4}))
    params = djpt.traverse(scene)
    target = djpt.render(scene, spp=128, seed=77)
    opt = Adam(lr=0.03, params={ALBEDO: djpt.Color3f(0.3, 0.3, 0.3)})
    for step in range(80):
        opt[ALBEDO] = dr.clip(opt[ALBEDO], 0, 1)
        params.update(opt)
        image = djpt.render(scene, params, spp=16, seed=step)
        dr.backward(dr.mean(dr.square((image - target).array)))
        opt.step()
    np.testing.assert_allclose(np.array(opt[ALBEDO]).ravel(), [0.570068, 0.0430135, 0.0443706], atol=0.03)


# ---------------------------------------------------------------- Mitsuba


@pytest.mark.parametrize("rfilter", [pytest.param("box", marks=pytest.mark.slow), "gaussian"])
def test_against_mitsuba(rfilter: str) -> None:
    mi = pytest.importorskip("mitsuba")
    names = ["red.reflectance.value", "green.reflectance.value", "white.reflectance.value", RADIANCE]
    description = box(32, rfilter, {"type": "prb", "max_depth": 8})
    # Mitsuba refuses equal seeds for image and gradient.
    experiment = Experiment(description, names, seed_grad=SEED + 1)
    mine = experiment.gradients()
    theirs(description, 1)  # sets the variant
    mi.set_variant("llvm_ad_rgb")
    scene = mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False)
    params = mi.traverse(scene)
    for name in names:
        dr.enable_grad(params[name])
    params.update()
    image = mi.render(scene, params, **experiment.options, seed=SEED)
    dr.backward(dr.mean(image.array * mi.Float(experiment.weights.ravel())))
    for name in names:
        other = np.array(dr.grad(params[name])).ravel()
        np.testing.assert_allclose(mine[name], other, atol=1e-3 * np.abs(other).max(), err_msg=name)


# ---------------------------------------------------------------- the checks themselves


def scaled(factor: float) -> Callable[..., Any]:
    """An `Accumulator.add` whose gradients are off by a factor."""
    original = replay.Accumulator.add

    def add(self: Any, sums: Any, leaves: Any, active: Any) -> Any:
        after = original(self, sums, leaves, active)
        return [a + (b - a) * factor for a, b in zip(sums, after, strict=True)]

    return add


def forgetful() -> Callable[..., Any]:
    """An `Accumulator.add` that overlooks the first value that a vertex looked up."""
    original = replay.Accumulator.add

    def add(self: Any, sums: Any, leaves: Any, active: Any) -> Any:
        del leaves.taken[:1]
        return original(self, sums, leaves, active)

    return add


MUTATIONS = {
    "1 % too large": (replay.Accumulator, "add", scaled(1.01)),
    "wrong sign": (replay.Accumulator, "add", scaled(-1.0)),
    "nothing": (replay.Accumulator, "add", scaled(0.0)),
    "a look-up forgotten": (replay.Accumulator, "add", forgetful()),
}


@pytest.mark.sparse(2)
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_a_wrong_gradient_fails(mutation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*MUTATIONS[mutation])
    with pytest.raises(AssertionError):
        Experiment(box(16, "box", PRB), ["white.reflectance.value", ALBEDO]).check()
