"""The examples do what they say."""

from __future__ import annotations

import importlib.util
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from tests.kit.processes import ROOT, run_python

EXAMPLES = ROOT / "examples"

pytestmark = pytest.mark.skipif(not EXAMPLES.is_dir(), reason="not a working copy of the repository")


def load_example(name: str) -> ModuleType:
    """An example as a module, without running it."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def albedo() -> ModuleType:
    return load_example("albedo")


def recovered(albedo: ModuleType, size: int, **options: Any) -> tuple[float, list[float]]:
    """The largest error of the nine numbers, and the loss of each step."""
    scene = albedo.load(size)
    params = djpt.traverse(scene)
    truth = albedo.values(params)
    target = djpt.render(scene, spp=256, seed=2**31)
    for key in albedo.KEYS:
        params[key] = 0.5
    params.update()
    losses: list[float] = []
    found = albedo.recover(scene, target, report=lambda step, loss: losses.append(loss), **options)
    return max(float(np.abs(found[key] - truth[key]).max()) for key in albedo.KEYS), losses


@pytest.mark.slow
def test_albedos_are_recovered_from_a_small_picture(albedo: ModuleType) -> None:
    error, losses = recovered(albedo, 48, steps=60)
    assert error < 0.015
    assert np.mean(losses[-5:]) < losses[0] / 5


@pytest.mark.slow
def test_albedos_are_recovered_within_a_hundredth(albedo: ModuleType) -> None:
    error, losses = recovered(albedo, 256)
    assert error < 0.01
    assert losses[-1] < losses[0] / 10


@pytest.mark.slow
def test_the_albedo_script_prints_the_loss_and_writes_a_picture(tmp_path: Any) -> None:
    picture = tmp_path / "albedo.png"
    done = run_python(
        str(EXAMPLES / "albedo.py"), "--out", str(picture), "--size", "24", "--steps", "3", "--spp", "4", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "loss" in done.stdout and "white" in done.stdout
    assert np.array(djpt.read(picture)).shape == (24, 3 * 24, 3)


@pytest.mark.slow
def test_smoke_is_recovered_from_nothing() -> None:
    """In a tiny form: 8^3 densities from 16 x 16 pixels."""
    smoke = load_example("smoke")
    truth = smoke.ring(8)
    scene = smoke.load(truth, 16)
    pictures = [djpt.render(scene, sensor=view, spp=256, seed=1000 + view) for view in range(len(smoke.GIVEN))]
    losses: list[float] = []
    found = smoke.recover(scene, pictures, resolution=8, steps=24, report=lambda step, loss: losses.append(loss))[
        ..., 0
    ]
    # Six steps look at all views.
    assert np.mean(losses[-6:]) < np.mean(losses[:6]) / 2
    assert np.corrcoef(found.ravel(), truth.ravel())[0, 1] > 0.4


@pytest.mark.slow
def test_the_smoke_script_prints_the_loss_and_writes_a_picture(tmp_path: Any) -> None:
    picture = tmp_path / "smoke.png"
    options = {"--size": "16", "--resolution": "4", "--steps": "3", "--spp": "2"}
    arguments = [word for pair in options.items() for word in pair]
    done = run_python(str(EXAMPLES / "smoke.py"), "--out", str(picture), *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "loss" in done.stdout and "relative error" in done.stdout
    assert np.array(djpt.read(picture)).shape == (2 * 16, 4 * 16, 3)


@pytest.mark.slow
def test_a_pose_is_found_from_a_small_picture() -> None:
    """From nearby; with a picture of 48 x 48 pixels."""
    pose = load_example("pose")
    scene = pose.load(48)
    start = pose.orbiting(36, 32, 6.6, 33.0)
    blurs = (1 / 8, 1 / 16, 1 / 16, 1 / 32, 1 / 32, 1 / 64, 1 / 64)
    found = pose.search(scene, pose.picture(scene, pose.TRUTH, 1024), start, blurs=blurs)
    assert start.errors(pose.TRUTH)[0] > 6
    angle, way, length = found.errors(pose.TRUTH)
    assert angle < 0.2 and way < 0.02 and length < 0.02


@pytest.mark.slow
def test_a_pose_is_found_from_far_away() -> None:
    pose = load_example("pose")
    scene = pose.load(128)
    found = pose.search(scene, pose.picture(scene, pose.TRUTH, 1024), pose.START)
    angle, way, length = found.errors(pose.TRUTH)
    assert angle < 0.1 and way < 0.005 and length < 0.005


@pytest.mark.slow
def test_a_lamp_is_found_by_its_shadow() -> None:
    lamp = load_example("lamp")
    scene = lamp.load(32)
    target = djpt.render(scene, spp=256, seed=2**20)
    found = lamp.search(scene, target, lamp.START)
    assert np.linalg.norm(np.array(lamp.START) - lamp.TRUTH) > 2.5
    assert np.linalg.norm(found - lamp.TRUTH) < 0.03


@pytest.mark.slow
def test_a_glass_ball_is_found_by_its_caustic() -> None:
    caustic = load_example("caustic")
    scene = caustic.load(24)
    target = caustic.trace(scene, djpt.Point3f(*caustic.TRUTH), 64, 2**20)
    found = caustic.search(scene, target, caustic.START, steps=60)
    assert np.linalg.norm(np.array(caustic.START) - caustic.TRUTH) > 0.5
    assert np.linalg.norm(found - caustic.TRUTH) < 0.02


@pytest.mark.slow
def test_light_through_glass_is_that_of_light_tracing() -> None:
    """The picture is that of `ptracer`, and its derivatives are those of differences.

    The example leaves out light that goes from the floor to the ball and back: so do paths of four edges, through the
    ball once, but for a thousandth of the light.
    """
    caustic = load_example("caustic")
    caustic.DEPTH = 3
    scene = caustic.load(16)
    params = djpt.traverse(scene)
    tracer = djpt.load_dict({"type": "ptracer", "max_depth": 4})

    def traced(theta: djpt.Float, axis: int, seed: int) -> djpt.TensorXf:
        center = [djpt.Float(x) for x in caustic.TRUTH]
        center[axis] = center[axis] + theta
        params[caustic.KEY] = djpt.Transform4f().translate(djpt.Point3f(*center)).scale(caustic.RADIUS)
        params.update()
        return caustic.trace(scene, djpt.Point3f(*center), 256, seed)

    image = np.array(traced(djpt.Float(0), 0, 0))
    light = np.array(caustic.inner(djpt.render(scene, spp=4096, integrator=tracer)))
    assert image.mean() == pytest.approx(light.mean(), rel=0.01)
    # Few of the tracer's rays meet the ball: pixels are noisy, blocks of them less so.
    blocks = (image - light)[..., 0].reshape(4, 4, 4, 4).mean(axis=(1, 3))
    assert np.abs(blocks).mean() < 0.03 * light.mean()
    weights = np.cos(0.4 * np.arange(16))[:, None, None] + np.sin(0.5 * np.arange(16))[None, :, None]
    for axis in range(3):
        found, expected = [], []
        for seed in range(4):
            theta = djpt.Float(0)
            dr.enable_grad(theta)
            picture = traced(theta, axis, seed)
            dr.forward(theta)
            found.append((weights * np.array(dr.grad(picture))).sum())
            ahead, back = (np.array(traced(djpt.Float(x), axis, seed)) for x in (0.005, -0.005))
            expected.append((weights * (ahead - back)).sum() / 0.01)
        error = np.std(np.subtract(found, expected), ddof=1) / 2
        assert np.mean(found) == pytest.approx(np.mean(expected), rel=0.02, abs=4 * error)


@pytest.mark.slow
def test_a_pane_of_glass_is_shaped_for_a_picture() -> None:
    lens = load_example("lens")
    scene = lens.load(24, 17)
    before = djpt.render(scene, spp=256, seed=2**20).numpy()
    wanted = lens.picture(24)[:, :, None] * [1.0, 1.0, 1.0]
    target = djpt.TensorXf((wanted * before.sum() / wanted.sum()).astype(np.float32))
    lens.search(scene, target, steps=20, spp=16, levels=(5, 9, 17))
    after = djpt.render(scene, spp=256, seed=2**20).numpy()
    losses = [np.square(image - target.numpy()).mean() for image in (before, after)]
    assert losses[1] < 0.25 * losses[0]
    assert after.sum() == pytest.approx(before.sum(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pose", "lamp", "caustic"])
def test_the_scripts_of_places_print_errors_and_write_pictures(name: str, tmp_path: Any) -> None:
    options = ["--size", "16", "--spp", "1"] + (["--steps", "2"] if name != "pose" else [])
    done = run_python(str(EXAMPLES / f"{name}.py"), "--out", str(tmp_path / "a.png"), *options, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert ("off by" if name != "pose" else "focal length") in done.stdout
    assert np.array(djpt.read(tmp_path / "a.png")).shape == (16, 3 * 16, 3)


@pytest.mark.slow
def test_an_own_integrator_is_differentiated_without_adjoint_code(tmp_path: Any) -> None:
    """The script compares the derivative with a finite difference, and fails if they differ."""
    picture = tmp_path / "sky.png"
    done = run_python(
        str(EXAMPLES / "own_integrator.py"), "--out", str(picture), "--size", "48", "--spp", "16", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "differentiation" in done.stdout
    image = np.array(djpt.read(picture))
    assert image.shape == (48, 48, 3)
    # High up nothing is near the wall, whose reflectance is 0.6; the foot of the ball sees less of the sky.
    assert image[0].mean() == pytest.approx(0.6, rel=0.01)
    assert 0.05 < image[35, 12].mean() < 0.3


def test_examples_use_the_public_api_only() -> None:
    for path in EXAMPLES.glob("*.py"):
        source = path.read_text()
        assert "from djpt." not in source, path
        assert "import djpt." not in source, path
        compile(source, str(path), "exec")
