"""Renders in rounds: the same bits however they are cut, an error that is true, and a stop at the first limit."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.interruption import interruptible
from djpt.errors import RenderError
from djpt.rendering.progressive import rounds
from djpt.rendering.progressive.rounds import round_seed
from djpt.scene.scene import Scene

SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")


def box(sampler: str = "independent", rfilter: str = "box", size: int = 12, **changes: Any) -> Scene:
    """The Cornell box on a few pixels."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=size, height=size, rfilter={"type": rfilter})
    description["sensor"]["sampler"] = {"type": sampler, "sample_count": 16}
    return djpt.load_dict({**description, **changes})


def last(scene: Scene, **options: Any) -> djpt.Accumulation:
    """The result of a render in rounds."""
    *_, result = djpt.render_passes(scene, **options)
    return result


@pytest.mark.sparse(16)
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_going_on_gives_the_bits_of_a_longer_render(sampler: str, rfilter: str) -> None:
    scene = box(sampler, rfilter)
    short = last(scene, spp=32, round_spp=16, seed=3)
    longer = last(box(sampler, rfilter), spp=64, seed=3, resume_from=short)
    at_once = last(scene, spp=64, round_spp=16, seed=3)
    assert longer.spp == at_once.spp >= 64
    np.testing.assert_array_equal(longer.image().numpy(), at_once.image().numpy())
    assert longer.error().overall == at_once.error().overall


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.sparse(6)
def test_one_round_is_a_plain_render(sampler: str, rfilter: str) -> None:
    scene = box(sampler, rfilter)
    np.testing.assert_array_equal(
        last(scene, spp=20, seed=5).image().numpy(), djpt.render(scene, spp=20, seed=5).numpy()
    )


@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "ptracer"},
        {"type": "depth"},
        {"type": "aov", "aovs": "d:depth,n:sh_normal", "image": {"type": "path"}},
    ],
    ids=lambda node: node["type"],
)
def test_every_integrator_goes_on(integrator: dict[str, Any]) -> None:
    scene, chosen = box(rfilter="gaussian"), djpt.load_dict(integrator)
    first = next(djpt.render_passes(scene, integrator=chosen, spp=16, round_spp=8))
    image = djpt.render(scene, integrator=chosen, spp=8)
    np.testing.assert_array_equal(first.image().numpy(), image.numpy())
    assert first.channels == djpt.channel_names(scene, integrator=chosen)
    both = last(scene, integrator=chosen, spp=16, resume_from=first).image().numpy()
    np.testing.assert_array_equal(both, last(scene, integrator=chosen, spp=16, round_spp=8).image().numpy())
    assert both.shape == image.shape


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("sampler", ["independent", pytest.param("multijitter", marks=pytest.mark.slow)])
@pytest.mark.sparse(2)
def test_recorded_rounds_are_plain_renders(sampler: str, rfilter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where lanes compute several pixels."""
    scene = box(sampler, rfilter, size=64)
    monkeypatch.setattr(rounds, "LANES", 2**12 // (4 * dr.thread_count()))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        found = last(scene, spp=20, round_spp=4, seed=5)
        sizes = [kernel["size"] for kernel in dr.kernel_history()]
    assert sizes.count(2**12 // 4) >= 3 or rfilter == "box"
    images = [djpt.render(scene, spp=4, seed=round_seed(5, number)) for number in range(5)]
    total = np.zeros((64, 64, 3))
    for image, number in zip(images, range(5), strict=True):
        one = last(scene, spp=4, seed=round_seed(5, number))
        np.testing.assert_array_equal(one.image().numpy(), image.numpy())
        total += np.moveaxis(one.sums, 0, 2)
    np.testing.assert_array_equal(np.moveaxis(found.sums, 0, 2), total)


def test_the_image_is_the_mean_of_the_rounds() -> None:
    scene = box()
    rounds = [djpt.render(scene, spp=8, seed=round_seed(9, number)).numpy() for number in range(3)]
    np.testing.assert_allclose(last(scene, spp=24, round_spp=8, seed=9).image().numpy(), np.mean(rounds, 0), rtol=1e-6)


@pytest.mark.sparse(16)
@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_a_last_round_is_smaller(sampler: str, rfilter: str) -> None:
    """It is an image of `render`, and rendered anew in full by a render that goes on."""
    scene = box(sampler, rfilter)
    whole, smaller = (scene.sensors()[0].sampler().round_count(spp) for spp in (16, 9))
    found = last(scene, spp=2 * whole + 9, round_spp=16, seed=3)
    assert (found.counts, found.spp) == ((whole, whole, smaller), 2 * whole + smaller)
    assert found.samples().numpy().max() == found.samples().numpy().min() == found.spp
    parts = [last(scene, spp=spp, seed=round_seed(3, number)) for number, spp in enumerate(found.counts)]
    np.testing.assert_array_equal(found.sums, sum(part.sums for part in parts))
    np.testing.assert_array_equal(parts[2].image().numpy(), djpt.render(scene, spp=9, seed=round_seed(3, 2)).numpy())
    longer = last(box(sampler, rfilter), spp=4 * whole, seed=3, resume_from=found)
    at_once = last(scene, spp=4 * whole, round_spp=16, seed=3)
    assert longer.counts == at_once.counts
    np.testing.assert_array_equal(longer.image().numpy(), at_once.image().numpy())
    assert longer.error().overall == at_once.error().overall


def test_every_number_of_samples_is_taken() -> None:
    for spp in (1, 5, 8, 13):
        assert last(box(), spp=spp, round_spp=8).spp == spp
        assert last(box(), spp=spp).spp == spp
    assert last(box(size=4), spp=200).counts == (64, 64, 64, 8)


def test_an_accumulation_is_not_changed_by_the_next_round() -> None:
    kept = [(found, found.image().numpy()) for found in djpt.render_passes(box(), spp=24, round_spp=8)]
    assert [found.spp for found, _ in kept] == [8, 16, 24]
    for found, image in kept:
        np.testing.assert_array_equal(found.image().numpy(), image)


def test_rounds_have_seeds_of_their_own() -> None:
    assert round_seed(7, 0) == 7
    assert len({round_seed(7, number) for number in range(10000)}) == 10000
    assert not {round_seed(0, number) for number in range(1000)} & {round_seed(1, number) for number in range(1000)}


# ---- limits ------------------------------------------------------------------------------


def test_a_render_stops_at_the_first_limit() -> None:
    scene = box()
    assert last(scene, round_spp=16, target_error=0.25, spp=4096).error().overall <= 0.25
    assert last(scene, round_spp=4, target_error=1e-6, spp=9).spp == 9
    assert last(scene, round_spp=4, time_budget=1e-9).spp == 4
    assert last(scene).spp == 16


def test_four_rounds_at_least_say_that_an_image_is_good() -> None:
    assert last(box(), round_spp=4, target_error=100.0).rounds == 4


def test_nothing_is_rendered_if_nothing_is_left() -> None:
    found = last(box(), spp=16, round_spp=8)
    assert list(djpt.render_passes(box(), spp=16, resume_from=found)) == [found]


def test_a_signal_ends_a_round_that_is_watched() -> None:
    with interruptible(keeps=False) as interruption, pytest.raises(KeyboardInterrupt):
        for _ in djpt.render_passes(box(), spp=2**30, interruption=interruption, time_budget=100.0):
            signal.raise_signal(signal.SIGINT)
            interruption.check()


@pytest.mark.parametrize("adaptive", [False, True])
def test_a_signal_says_what_share_of_all_samples_was_taken(adaptive: bool) -> None:
    """Not of the samples of a round."""
    for options, share in (({"spp": 1600}, " after 2 % of the samples"), ({"target_error": 1e-9}, "")):
        with interruptible(keeps=False) as interruption:
            passes = djpt.render_passes(box(), round_spp=16, adaptive=adaptive, interruption=interruption, **options)
            assert [next(passes).spp for _ in range(2)] == [16, 32]
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt, match=f"interrupted{share}: the image has what exists"):
                interruption.leave("the image has what exists")


def test_a_signal_in_a_round_says_what_share_of_all_samples_was_taken() -> None:
    with interruptible(keeps=False) as interruption:
        passes = djpt.render_passes(box(), spp=1600, round_spp=16, interruption=interruption)
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt, match="interrupted after 1 % of the samples: nothing is kept"):
            next(passes)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target_error": 0.0}, "'target_error' must be a number above 0"),
        ({"time_budget": float("nan")}, "'time_budget' must be a number above 0"),
        ({"spp": -1}, "'spp'"),
        ({"round_spp": 1.5}, "'round_spp'"),
        ({"seed": -1}, "'seed'"),
    ],
)
def test_wrong_arguments_are_refused_at_once(options: dict[str, Any], message: str) -> None:
    with pytest.raises(RenderError, match=message):
        djpt.render_passes(box(), **options)


# ---- what can't go on ----------------------------------------------------------------------


def test_a_changed_scene_is_refused() -> None:
    scene = box()
    found = last(scene, spp=8, round_spp=8)
    parameters = djpt.traverse(scene)
    parameters["red.reflectance.value"] = [0.1, 0.2, 0.3]
    parameters.update()
    with pytest.raises(RenderError, match="differs in 'red'"):
        djpt.render_passes(scene, spp=16, resume_from=found)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda: box(size=13), "the film"),
        (lambda: box(rfilter="tent"), "the film"),
        (lambda: box(sampler="stratified"), "the sampler"),
        (lambda: box(integrator={"type": "path", "max_depth": 3}), "the integrator"),
        (lambda: box(more={"type": "sphere"}), "'more'"),
    ],
)
def test_other_images_are_refused(changed: Any, message: str) -> None:
    found = last(box(), spp=8, round_spp=8)
    with pytest.raises(RenderError, match=f"differs in .*{message}"):
        djpt.render_passes(changed(), spp=16, resume_from=found)


def test_another_order_of_lights_is_refused() -> None:
    lights = {"lamp": {"type": "rectangle", "emitter": {"type": "area"}}, "sky": {"type": "constant"}}
    scenes = [djpt.load_dict({**djpt.cornell_box(), **lights}, optimize=optimize) for optimize in (True, False)]
    found = last(scenes[0], spp=8, round_spp=8)
    with pytest.raises(RenderError, match="differs in the order of lights"):
        djpt.render_passes(scenes[1], spp=16, resume_from=found)


def test_other_rounds_are_refused() -> None:
    found = last(box(), spp=8, round_spp=8)
    with pytest.raises(RenderError, match="its rounds have 8 spp"):
        djpt.render_passes(box(), spp=16, round_spp=16, resume_from=found)
    with pytest.raises(RenderError, match="its seed is 0, not 1"):
        djpt.render_passes(box(), spp=16, seed=1, resume_from=found)


# ---- sums --------------------------------------------------------------------------------


def test_accumulations_of_different_seeds_add_up() -> None:
    parts = [last(box(rfilter="gaussian"), spp=16, round_spp=8, seed=seed) for seed in (0, 1)]
    both = parts[0] + parts[1]
    assert both.spp == 32
    mean = (parts[0].sums + parts[1].sums) / (parts[0].weights + parts[1].weights)
    np.testing.assert_array_equal(both.image().numpy(), np.moveaxis(mean, 0, 2).astype(np.float32))
    assert both.error().overall < max(part.error().overall for part in parts)
    with pytest.raises(RenderError, match="both contain the round of seed"):
        both + parts[1]
    with pytest.raises(RenderError, match="several seeds"):
        djpt.render_passes(box(rfilter="gaussian"), spp=64, resume_from=both)


@pytest.mark.parametrize("adaptive", [False, True])
def test_smaller_rounds_add_up(tmp_path: Path, adaptive: bool) -> None:
    parts = [last(box(size=24), spp=26, round_spp=4, seed=seed, adaptive=adaptive) for seed in (0, 1)]
    both = parts[0] + parts[1]
    assert both.spp == 52
    assert both.counts.count(2) == 2
    assert both.samples().numpy().mean() == pytest.approx(52, abs=1 if adaptive else 0)
    assert both.error().overall < max(part.error().overall for part in parts)
    both.save(tmp_path / "both.djpt")
    np.testing.assert_array_equal(djpt.Accumulation.load(tmp_path / "both.djpt").image().numpy(), both.image().numpy())
    with pytest.raises(RenderError, match="several seeds"):
        djpt.render_passes(box(size=24), spp=64, resume_from=both, adaptive=adaptive)


def test_accumulations_of_different_images_do_not() -> None:
    found = last(box(), spp=8, round_spp=8)
    with pytest.raises(RenderError, match="the film"):
        found + last(box(size=13), spp=8, seed=1)
    with pytest.raises(RenderError, match="'round_spp' is 8 and 4"):
        found + last(box(), spp=4, seed=1)


@pytest.mark.parametrize("adaptive", [False, True])
def test_other_versions_and_schedules_are_refused(adaptive: bool) -> None:
    """Their rounds have other bits, and may be of another image."""
    found = last(box(), spp=8, round_spp=4, adaptive=adaptive)
    assert found.software == f"djpt {djpt.__version__}, drjit {dr.__version__}"
    for software in (found.software.replace("djpt ", "djpt 9"), found.software.replace("drjit ", "drjit 9")):
        other = replace(found, software=software)
        with pytest.raises(RenderError, match=f"{software}, others would come from {found.software}"):
            djpt.render_passes(box(), spp=16, resume_from=other, adaptive=adaptive)
        with pytest.raises(RenderError, match=f"{found.software}, others would come from {software}"):
            found + replace(other, seeds=(5, 6))
    with pytest.raises(RenderError, match="its schedule is 'auto', not 'wave'"):
        djpt.render_passes(box(), spp=16, resume_from=found, adaptive=adaptive, schedule="wave")


@pytest.mark.parametrize("adaptive", [False, True])
def test_arrays_of_another_image_are_refused(adaptive: bool) -> None:
    """Also if the fingerprint is the right one."""
    found, other = (last(box(size=size), spp=8, round_spp=4, adaptive=adaptive) for size in (12, 20))
    with pytest.raises(RenderError, match=r"its size is \(20, 20\), not \(12, 12\)"):
        djpt.render_passes(box(), spp=16, resume_from=replace(other, fingerprint=found.fingerprint), adaptive=adaptive)


# ---- errors ------------------------------------------------------------------------------


@pytest.mark.sparse(2)
@pytest.mark.parametrize("spp", [32, 26])
@pytest.mark.slow
def test_the_error_is_that_of_many_renders(spp: int) -> None:
    """Over 40 seeds the mean of the estimated squares is that of the true ones: their own errors are some percent."""
    scene, true, estimated = box(integrator={"type": "path", "hide_emitters": True}), [], []
    reference = last(scene, spp=8192, round_spp=4096, seed=100).image().numpy()
    weights = np.array([0.212671, 0.715160, 0.072169], np.float32)
    mean = (reference @ weights).mean()
    for seed in range(40):
        found = last(scene, spp=spp, round_spp=8, seed=seed)
        true.append(np.mean(((found.image().numpy() - reference) @ weights) ** 2) / mean**2)
        estimated.append(found.error().overall ** 2)
    assert np.sqrt(np.mean(estimated)) == pytest.approx(np.sqrt(np.mean(true)), rel=0.15)
    assert found.error().pixels.shape == (12, 12)
    assert np.isinf(last(scene, spp=8, round_spp=8).error().overall)


@pytest.mark.slow
@pytest.mark.parametrize("adaptive", [False, True])
@pytest.mark.parametrize(
    "name", ["cornell_box", "cornell_box_boxfilter", "cornell_box_spheres", "shader_ball", "stage"]
)
def test_a_target_is_met(name: str, adaptive: bool) -> None:
    """Renders that stop at an error of 1 % have one of 0.8 % to 1.2 %, in the mean of squares over four seeds.

    That of a single one varies by 13 % where few paths carry much light. Without lamps in the
    picture, at whose edges few pixels would have nearly all of the error.
    """
    from djpt.scenes.overrides import described, override

    _, description = described(name, {})
    description["integrator"]["hide_emitters"] = True
    scene = djpt.load_dict(override(description, width=24))
    found = [last(scene, target_error=0.01, seed=seed, adaptive=adaptive) for seed in range(1, 5)]
    reference = last(scene, round_spp=found[0].spp, spp=8 * found[0].spp, seed=2**31)
    weights = np.array([0.212671, 0.715160, 0.072169])
    *images, truth = (one.image().numpy()[..., :3].astype(np.float64) @ weights for one in (*found, reference))
    # The reference has noise of its own, a third of an image's.
    square = np.mean([(image - truth) ** 2 for image in images]) / truth.mean() ** 2 - reference.error().overall ** 2
    assert 0.008 < np.sqrt(square) < 0.012
    assert all(one.rounds > 4 for one in found)
