"""The volumetric path tracer: closed forms, Mitsuba's images with the same seed, and its statistics."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.validation.gradcheck.losses import quotient
from tests.kit.derivatives import by_both
from tests.kit.media_scenes import GLASS, NULL, colour, fog, foggy_room, lit_ball
from tests.kit.renders import box, ours, pixels, theirs

LAMP = {
    "type": "sphere",
    "center": [0, 1.5, 0],
    "radius": 0.3,
    "bsdf": NULL,
    "emitter": {"type": "area", "radiance": colour(3, 2, 1)},
}


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("bsdf", [NULL, GLASS], ids=["null", "glass"])
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.sparse(2)
def test_furnace(bsdf: dict[str, Any], schedule: str) -> None:
    """What only scatters is invisible under a white sky."""
    image = ours(lit_ball(fog(3.0, 1.0), bsdf), spp=512, schedule=schedule)
    assert image.mean() == pytest.approx(1, abs=1e-3)
    assert np.abs(image - 1).max() < 0.1


@pytest.mark.parametrize("bsdf", [NULL, GLASS], ids=["null", "glass"])
@pytest.mark.sparse(2)
def test_coloured_furnace(bsdf: dict[str, Any]) -> None:
    image = ours(lit_ball(fog(colour(0.5, 2, 4), 1.0), bsdf, "volpathmis"), spp=2048)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), 1, atol=4e-3)


@pytest.mark.parametrize("integrator", ["volpath", "volpathmis"])
@pytest.mark.sparse(2)
def test_absorption(integrator: str) -> None:
    """exp(-sigma_t d) through the middle of a ball, for a medium that doesn't scatter."""
    sigma = np.array([0.2, 0.5, 0.9])
    scene = lit_ball(fog(colour(*sigma), 0.0), integrator=integrator)
    scene["sensor"]["fov"] = 0.1
    means = np.array([ours(scene, spp=256, seed=seed).mean(axis=(0, 1)) for seed in range(16)])
    error = means.std(axis=0, ddof=1) / 4
    assert (np.abs(means.mean(axis=0) - np.exp(-2 * sigma)) < 4 * error).all()


def test_single_scattering_in_a_slab() -> None:
    """L = albedo / (8 pi^2 ..): a beam of parallel light through a thick, dark medium, seen from where it comes.

    With one scattering event, light straight down and a viewer straight above: L = E albedo / (4 pi 2).
    """
    scene = lit_ball(None, max_depth=3)
    del scene["sky"], scene["ball"]
    scene["sun"] = {"type": "directional", "direction": [0, 0, -1], "irradiance": 1.0}
    cube = {"type": "cube", "to_world": T().scale([50, 50, 1]), "bsdf": NULL, "interior": fog(20.0, 0.3)}
    scene["slab"], scene["integrator"]["max_depth"] = cube, 2
    scene["sensor"]["fov"] = 0.1
    image = ours(scene, spp=1024)
    assert image.mean() == pytest.approx(0.3 / (8 * np.pi), rel=0.01)


# ---------------------------------------------------------------- as Mitsuba


@pytest.mark.parametrize(
    "medium",
    [fog(0.5, 0.9, sample_emitters=False), fog(colour(0.3, 0.5, 0.9), colour(0.9, 0.8, 0.7), sample_emitters=False)],
    ids=["grey", "coloured"],
)
@pytest.mark.parametrize("bsdf", [NULL, GLASS], ids=["null", "glass"])
@pytest.mark.sparse(4)
def test_same_seed(medium: dict[str, Any], bsdf: dict[str, Any]) -> None:
    """Without shadow rays through media, whose transmittance Mitsuba estimates, images are equal."""
    scene = lit_ball(medium, bsdf, max_depth=12, rr_depth=3, lamp=LAMP)
    mine, reference = ours(scene, spp=16, seed=3), theirs(scene, spp=16, seed=3)
    close = np.isclose(mine, reference, rtol=1e-3, atol=1e-5).all(axis=-1)
    assert close.mean() > 0.97


def test_a_scene_without_media() -> None:
    """Equal to Mitsuba's `volpath`."""
    scene = box(16, integrator={"type": "volpath", "max_depth": 6})
    mine, reference = ours(scene, spp=8, seed=2), theirs(scene, spp=8, seed=2)
    assert np.isclose(mine, reference, rtol=1e-3, atol=1e-5).all(axis=-1).mean() > 0.97


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["volpath", "volpathmis"])
@pytest.mark.parametrize("around", [False, True], ids=["inside", "around"])
@pytest.mark.parametrize("emitters", [True, False])
def test_statistics(integrator: str, around: bool, emitters: bool) -> None:
    """Fog in the Cornell box."""
    medium = fog(colour(0.4, 0.5, 0.6), colour(0.9, 0.8, 0.7), sample_emitters=emitters)
    scene = foggy_room(medium, integrator, around)
    mine = np.array([ours(scene, spp=512, seed=seed).mean(axis=(0, 1)) for seed in range(8)])
    reference = np.array([theirs(scene, spp=512, seed=100 + seed).mean(axis=(0, 1)) for seed in range(8)])
    error = np.sqrt((mine.var(axis=0, ddof=1) + reference.var(axis=0, ddof=1)) / 8)
    z = (mine.mean(axis=0) - reference.mean(axis=0)) / error
    assert np.abs(z).max() < 5


# ---------------------------------------------------------------- by itself


def test_schedules_agree() -> None:
    scene = foggy_room(fog(0.5, 0.9))
    flat, wave = (ours(scene, spp=16, seed=5, schedule=name) for name in ("flat", "wave"))
    np.testing.assert_allclose(flat, wave, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("gap", [0.02, -0.3], ids=["beside", "inside"])
@pytest.mark.sparse(2)
def test_light_sampling_changes_nothing_but_noise(gap: float) -> None:
    """A lamp just outside of the fog: most shadow rays leave it at a grazing angle."""
    means, errors = [], []
    for emitters in (True, False):
        scene = lit_ball(None, max_depth=2)
        del scene["sky"], scene["ball"]
        scene["fog"] = {"type": "cube", "bsdf": NULL, "interior": fog(0.5, 0.9, sample_emitters=emitters)}
        scene["lamp"] = {
            "type": "rectangle",
            "to_world": T().translate([0, 1 + gap, 0]).rotate([1, 0, 0], 90).scale(0.25),
            "emitter": {"type": "area", "radiance": 10.0},
        }
        values = np.array([ours(scene, spp=1024, seed=seed).mean() for seed in range(8)])
        means.append(values.mean())
        errors.append(values.std(ddof=1) / np.sqrt(8))
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors)


def test_what_hides_the_sky_may_stand_behind_an_invisible_surface() -> None:
    """A floor below a wide black ceiling is black, with a null surface between them or without."""

    def rectangle(z: float, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {"type": "rectangle", "to_world": T().translate([0, 0, z]).scale([100, 100, 1]), "bsdf": bsdf}

    scene = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 2},
        "sky": {"type": "constant"},
        "floor": rectangle(0, {"type": "diffuse"}),
        "pane": rectangle(4, NULL),
        "ceiling": rectangle(6, {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour(0, 0, 0)}}),
        "sensor": {
            "type": "perspective",
            "fov": 20,
            "to_world": T().look_at(origin=[0, 0, 2], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4},
        },
    }
    hidden = djpt.render(djpt.load_dict(scene), spp=16).numpy()
    assert hidden.max() < 0.01
    scene["ceiling"] = rectangle(6, NULL)
    # The floor reflects half of a sky of radiance 1.
    assert djpt.render(djpt.load_dict(scene), spp=256).numpy().mean() == pytest.approx(0.5, abs=0.03)


def test_other_integrators_see_no_fog() -> None:
    """As in Mitsuba; and they pay nothing."""
    clear = foggy_room(fog(), "path")
    scene = djpt.load_dict(clear)
    assert scene.camera_medium is None and scene.replace(all_media=True).camera_medium is not None
    clear["fog"].pop("interior")
    with pytest.warns(UserWarning, match="leaves out fog"):
        foggy = pixels(djpt.render(scene, spp=4))
    np.testing.assert_array_equal(foggy, ours(clear, spp=4))


def test_glass_that_absorbs_is_a_medium() -> None:
    """The key `absorption` of a dielectric, and a medium that doesn't scatter."""
    sigma = [0.2, 0.5, 0.9]
    absorbing = lit_ball(None, {**GLASS, "absorption": colour(*sigma)}, max_depth=12)
    medium = lit_ball(fog(colour(*sigma), 0.0), GLASS, "volpathmis", max_depth=12)
    mine, other = (ours(scene, spp=2048).mean(axis=(0, 1)) for scene in (absorbing, medium))
    np.testing.assert_allclose(mine, other, rtol=0.01)


def test_the_medium_of_the_camera_is_found() -> None:
    """Within the ball, also if nobody says so; in a bubble within the fog, none."""
    scene = lit_ball(fog(0.7, 0.0))
    scene["sensor"]["to_world"] = T().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, 1, 0])
    scene["sensor"]["fov"] = 0.1
    assert ours(scene, spp=1024).mean() == pytest.approx(np.exp(-0.7 * 0.99), rel=0.02)
    scene["bubble"] = {"type": "sphere", "radius": 0.5, "bsdf": NULL, "exterior": scene["ball"]["interior"]}
    assert ours(scene, spp=1024).mean() == pytest.approx(np.exp(-0.35), rel=0.02)


def test_other_integrators_warn_of_media() -> None:
    scene = djpt.load_dict(foggy_room(fog(1.0)))
    with pytest.warns(
        UserWarning, match=r"'Path' doesn't follow light .*: it leaves out fog\.interior; render"
    ) as caught:
        djpt.render(scene, integrator=djpt.load_dict({"type": "path"}), spp=1)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        djpt.render(scene, spp=1)
        djpt.render(scene, integrator=djpt.load_dict({"type": "depth"}), spp=1)


def test_an_edit_compiles_no_kernel() -> None:
    scene = djpt.load_dict(foggy_room(fog(colour(0.5, 0.6, 0.7), 0.9)))
    params = djpt.traverse(scene)
    before = pixels(djpt.render(scene, spp=2))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        params["fog.interior_medium.sigma_t.value.value"] = djpt.Color3f(1, 2, 3)
        params["fog.interior_medium.scale"] = 2.0
        params.update()
        after = pixels(djpt.render(scene, spp=2))
        compiled = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    assert not compiled and np.abs(before - after).max() > 0.01


def test_a_camera_that_moves_compiles_no_kernel() -> None:
    """Neither its image nor its derivative, wherever in the fog it stands."""
    scene = djpt.load_dict(foggy_room(fog(0.8, 0.6), size=8))
    params = djpt.traverse(scene)
    place = djpt.Transform4f(params["sensor.to_world"])

    def kernels(x: float, seed: int) -> set[int]:
        step = djpt.Float(x)
        dr.enable_grad(step)
        params["sensor.to_world"] = place @ djpt.Transform4f().translate([step, 0, 0])
        params.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.backward(dr.sum(djpt.render(scene, spp=2, seed=seed), axis=None))
            dr.eval(dr.grad(step))
            return {k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT}

    first, second, third = kernels(0.02, 3), kernels(0.05, 1), kernels(-0.03, 2)
    # Some of what the first one makes is kept.
    assert second <= first and second == third


def test_gradients_of_walls_behind_fog() -> None:
    """By a colour that is looked up where shadow rays go through null surfaces."""
    scene = djpt.load_dict(foggy_room(fog(0.8, 0.6), size=8))
    # The mean is a polynomial in the colour of which only the first terms count.
    found, expected = by_both(scene, "red.reflectance.value", 0.04, seed=1, spp=64)
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("name", ["albedo", "sigma_t"])
@pytest.mark.sparse(2)
@pytest.mark.slow
def test_gradients(name: str) -> None:
    """Path replay against differences, of a medium whose light is sampled; the derivative of the mean over images."""
    scene = djpt.load_dict(foggy_room(fog(0.8, 0.6), size=8))
    params = djpt.traverse(scene)
    key = f"fog.interior_medium.{name}.value.value"
    start = float(params[key][0])

    def loss(value: Any, seed: int) -> Any:
        params[key] = value
        params.update()
        return dr.mean(djpt.render(scene, params, spp=1024, seed=seed), axis=None)

    gradients, differences = [], []
    for seed in range(6):
        attached = djpt.Float(start)
        dr.enable_grad(attached)
        dr.backward(loss(attached, seed))
        gradients.append(dr.grad(attached)[0])
        moved = lambda x, seed=seed: float(np.array(loss(djpt.Float(start + x), seed + 50)))  # noqa: E731
        differences.append(quotient(moved, 0.05))
    error = np.hypot(*(np.std(x, ddof=1) / np.sqrt(6) for x in (gradients, differences)))
    assert abs(np.mean(gradients) - np.mean(differences)) < max(4 * error, 0.02 * abs(np.mean(differences)))
    assert abs(np.mean(gradients)) > 4 * np.std(gradients, ddof=1) / np.sqrt(6)
