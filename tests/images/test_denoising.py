"""Denoised images: both filters, the guides, the command, and Mitsuba's call."""

from __future__ import annotations

import importlib.util
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.cli.main import app
from djpt.rendering.denoising.filtering import Guides, denoise_pixels
from djpt.rendering.denoising.rendered import render_guides
from djpt.rendering.settings import RenderSettings

needs_wheel = pytest.mark.skipif(importlib.util.find_spec("mitsuba_oidn") is None, reason="needs mitsuba-oidn")
METHODS = [pytest.param("oidn", marks=needs_wheel), "nlm"]


def described(size: int = 32, rfilter: str = "box") -> dict[str, Any]:
    """The Cornell box, small."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=size, height=size, rfilter={"type": rfilter})
    return description


def error(image: Any, reference: Any) -> float:
    """The relMSE of two images."""
    a, b = np.asarray(image, np.float64), np.asarray(reference, np.float64)
    return float(np.mean(np.square(a - b) / (np.square(b) + 1e-2)))


def command(*words: str | Path) -> Any:
    """Run a command quietly; its exit code, or None."""
    return app([*map(str, words), "-q"], standalone_mode=False)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.sparse(2)
def test_noise_goes(method: str) -> None:
    scene = djpt.load_dict(described(64))
    reference = djpt.render(scene, spp=1024, seed=1)
    cleaned = djpt.render(scene, spp=16, denoise=method)
    noisy = scene.sensors()[0].film().develop()
    assert error(noisy, reference) > (5 if method == "oidn" else 2) * error(cleaned, reference)


@pytest.mark.slow
@needs_wheel
@pytest.mark.parametrize("name", ["cornell_box", "shader_ball"])
def test_sixteen_samples_are_eight_times_better(name: str) -> None:
    description = djpt.scenes.SCENES[name]()
    description["sensor"]["film"].update(width=128, height=128, rfilter={"type": "box"})
    scene = djpt.load_dict(description)
    cleaned = djpt.render(scene, spp=16, denoise=True)
    noisy = scene.sensors()[0].film().develop()
    reference = djpt.render(scene, spp=4096, seed=1)
    assert error(noisy, reference) > 8 * error(cleaned, reference)


def test_the_raw_image_keeps_its_bits() -> None:
    scene = djpt.load_dict(described())
    before = djpt.render(scene, spp=4, seed=3).numpy()
    cleaned = djpt.render(scene, spp=4, seed=3, denoise="nlm").numpy()
    np.testing.assert_array_equal(scene.sensors()[0].film().develop().numpy(), before)
    assert np.abs(cleaned - before).max() > 0
    np.testing.assert_array_equal(djpt.render(scene, spp=4, seed=3).numpy(), before)


def test_wide_filters_give_way_to_the_box() -> None:
    wide, box = (djpt.load_dict(described(rfilter=name)) for name in ("gaussian", "box"))
    plain = djpt.render(wide, spp=4).numpy()
    image = djpt.render(wide, spp=4, denoise="nlm").numpy()
    np.testing.assert_array_equal(image, djpt.render(box, spp=4, denoise="nlm").numpy())
    assert type(wide.sensors()[0].film().rfilter()).__name__ == "Gaussian"
    np.testing.assert_array_equal(djpt.render(wide, spp=4).numpy(), plain)


def test_a_signal_leaves_the_samples_that_exist() -> None:
    scene = djpt.load_dict(described(16, "gaussian"))

    def interrupt(done: int, total: int) -> None:
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        djpt.render(scene, spp=8, pass_spp=4, denoise="nlm", keep_partial=True, progress=interrupt)
    kept = scene.sensors()[0].film().develop().numpy()
    assert kept.shape == (16, 16, 3) and kept.mean() > 0.01


def test_alpha_and_layers_stay() -> None:
    pixels = np.random.default_rng(0).random((20, 17, 6), np.float32)
    names = ["R", "G", "B", "A", "depth.T", "id.I"]
    cleaned = djpt.denoise(pixels, channels=names, method="nlm").numpy()
    np.testing.assert_array_equal(cleaned[..., 3:], pixels[..., 3:])
    assert np.var(cleaned[..., :3]) < 0.5 * np.var(pixels[..., :3])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1, 1, 3), (2, 9, 3), (9, 2, 1), (5, 5, 4), (4, 6, 2)])
def test_images_of_any_shape(method: str, shape: tuple[int, int, int]) -> None:
    pixels = np.full(shape, 0.5, np.float32)
    pixels[0, 0, 0] = np.nan
    cleaned = djpt.denoise(pixels, method=method).numpy()
    assert cleaned.shape == shape and np.isfinite(cleaned).all()


def test_non_local_means_keeps_what_is_flat_and_edges_of_guides() -> None:
    flat = np.full((12, 12, 3), 0.25, np.float32)
    np.testing.assert_allclose(denoise_pixels(flat, Guides(), 3, "nlm"), flat, rtol=1e-6)
    random = np.random.default_rng(1)
    step = np.where(np.arange(32) < 16, 0.2, 0.8).astype(np.float32)[None, :, None] * np.ones((32, 1, 3), np.float32)
    light = 1 + 0.3 * random.standard_normal((32, 32, 3)).astype(np.float32)
    cleaned = denoise_pixels(step * light, Guides(albedo=step), 3, "nlm", clean=True)
    assert np.mean(np.square(cleaned - step)) < 0.05 * np.mean(np.square(step * light - step))
    np.testing.assert_allclose(cleaned[:, 16].mean() / cleaned[:, 15].mean(), 4, rtol=0.1)


def test_guides_show_albedo_and_normals() -> None:
    scene = djpt.load_dict(described())
    guides = render_guides(scene, RenderSettings.of(scene))
    assert guides.albedo is not None and guides.normal is not None
    np.testing.assert_allclose(guides.albedo[16, 1], [0.57, 0.043, 0.044], atol=2e-3)
    np.testing.assert_allclose(guides.normal[16, 1], [1, 0, 0], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(guides.normal[12, 20]), 1, atol=1e-3)


def test_guides_follow_mirrors_and_show_the_sky() -> None:
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.2, 0.4, 0.6]}}}
    to_world = djpt.ScalarTransform4f().look_at(origin=[0, 0, 2], target=[0, 0, 0], up=[0, 1, 0])
    sensor = {
        "type": "perspective",
        "fov": 20,
        "to_world": to_world,
        "film": {"type": "hdrfilm", "width": 4, "height": 4},
    }
    mirror = {"type": "rectangle", "bsdf": {"type": "conductor", "material": "none"}}
    behind = djpt.ScalarTransform4f().translate([0, 0, 4]).rotate([0, 1, 0], 180).scale(9)
    description = {"type": "scene", "sensor": sensor, "mirror": mirror, "sky": {"type": "constant", "radiance": 0.3}}
    scene = djpt.load_dict(description)
    sky = render_guides(scene, RenderSettings.of(scene))
    assert sky.albedo is not None and sky.normal is not None
    np.testing.assert_allclose(sky.albedo, 0.3, atol=1e-5)
    np.testing.assert_array_equal(sky.normal, 0)
    scene = djpt.load_dict(description | {"wall": wall | {"to_world": behind}})
    seen = render_guides(scene, RenderSettings.of(scene))
    assert seen.albedo is not None and seen.normal is not None
    np.testing.assert_allclose(seen.albedo, np.broadcast_to([0.2, 0.4, 0.6], (4, 4, 3)), atol=1e-5)
    np.testing.assert_allclose(seen.normal[..., 2], -1, atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_the_commands_agree(method: str, tmp_path: Path) -> None:
    at_once, raw, later = (tmp_path / name for name in ("a.exr", "raw.exr", "later.exr"))
    size = ("--width", "24", "--spp", "4")
    command("render", "cornell_box", "-o", at_once, *size, "--denoise", "--denoiser", method, "--raw", raw)
    command("denoise", raw, "-o", later, "--denoiser", method)
    np.testing.assert_array_equal(djpt.read(later).numpy()[..., :3], djpt.read(at_once).numpy())
    assert djpt.read_metadata(at_once)["denoised"] == method == djpt.read_metadata(later)["denoised"]
    scene = djpt.load_dict(described(24))
    np.testing.assert_array_equal(djpt.read(raw).numpy()[..., :3], djpt.render(scene, spp=4).numpy())
    command("denoise", raw, "-o", tmp_path / "b.png", "--denoiser", method)
    assert djpt.read(tmp_path / "b.png").shape == (24, 24, 3)


def test_layers_of_an_aov_scene_are_guides(tmp_path: Path) -> None:
    description = described(24)
    nested = {"type": "aov", "aovs": "albedo:albedo,sh_normal:sh_normal,depth:depth", "image": {"type": "path"}}
    scene = djpt.load_dict(description | {"integrator": nested})
    image, names = djpt.render(scene, spp=4), djpt.channel_names(scene)
    djpt.write(tmp_path / "aov.exr", image, channels=names)
    command("denoise", tmp_path / "aov.exr", "--denoiser", "nlm")
    found = djpt.read(tmp_path / "aov_denoised.exr").numpy()
    order = [names.index(name) for name in ("albedo.R", "albedo.G", "albedo.B")]
    pixels = image.numpy()
    normal = pixels[..., [names.index(f"sh_normal.{c}") for c in "XYZ"]]
    expected = djpt.denoise(pixels[..., :3], pixels[..., order], normal, method="nlm").numpy()
    np.testing.assert_array_equal(found[..., :3], expected)


def test_errors_say_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any) -> None:
    pixels = np.ones((4, 4, 3), np.float32)
    with pytest.raises(djpt.DjptError, match=r"unknown method 'nml'.*did you mean 'nlm'"):
        djpt.denoise(pixels, method="nml")
    with pytest.raises(djpt.DjptError, match=r"'albedo' must have the shape \(4, 4, 3\), found \(4, 5, 3\)"):
        djpt.denoise(pixels, np.ones((4, 5, 3), np.float32), method="nlm")
    with pytest.raises(djpt.DjptError, match=r"no colours to denoise: its channels are a\.X, a\.Y, a\.Z"):
        djpt.denoise(pixels, channels=["a.X", "a.Y", "a.Z"], method="nlm")
    with pytest.raises(djpt.DjptError, match="linear floats, found uint8"):
        djpt.denoise(np.ones((4, 4, 3), np.uint8), method="nlm")
    djpt.write(tmp_path / "a.exr", pixels)
    assert command("denoise", tmp_path / "a.exr", "--denoiser", "nlm", "--albedo", "albedo") == 2
    assert "no layer 'albedo' of three channels" in capsys.readouterr().err
    assert command("render", "cornell_box", "-o", tmp_path / "b.exr", "--raw", tmp_path / "raw.exr") == 2
    assert "--raw writes the input of --denoise" in capsys.readouterr().err
    monkeypatch.setitem(__import__("sys").modules, "mitsuba_oidn", None)
    with pytest.raises(djpt.BackendError, match=r"pip install mitsuba-oidn.*'nlm'"):
        djpt.denoise(pixels)


def test_derivatives_are_refused() -> None:
    import drjit as dr

    scene = djpt.load_dict(described(8))
    params = djpt.traverse(scene)
    key = "red.reflectance.value"
    dr.enable_grad(params[key])
    params.update()
    with pytest.raises(djpt.RenderError, match="denoised images have no derivatives"):
        djpt.render(scene, params, spp=1, denoise="nlm")


@needs_wheel
def test_mitsubas_call() -> None:
    scene = djpt.load_dict(described())
    noisy, guides = djpt.render(scene, spp=4), render_guides(scene, RenderSettings.of(scene))
    expected = djpt.denoise(noisy, guides.albedo, guides.normal).numpy()
    denoiser = djpt.OptixDenoiser([32, 32], albedo=True, normals=True)
    np.testing.assert_array_equal(denoiser(noisy, guides.albedo, guides.normal).numpy(), expected)
    names = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "nn.X", "nn.Y", "nn.Z"]
    layered = djpt.Bitmap(np.concatenate([noisy.numpy(), guides.albedo, guides.normal], axis=2), channel_names=names)
    result = denoiser(layered, albedo_ch="albedo", normals_ch="nn")
    np.testing.assert_array_equal(np.array(result), expected)
    with pytest.raises(djpt.DjptError, match="'albedo' is missing"):
        denoiser(noisy)
    with pytest.raises(djpt.DjptError, match="32 x 32 pixels, found 4 x 4"):
        denoiser(np.ones((4, 4, 3), np.float32), guides.albedo, guides.normal)
    with pytest.raises(djpt.BackendError, match="'temporal' must be False"):
        djpt.OptixDenoiser([32, 32], temporal=True)
