"""Images, derivatives and ray queries are the same on all devices, within rounding.

This process computes all of them, on a GPU if ``DJPT_VARIANT=cuda_ad_rgb``, and so does a process on the CPU. Rays are
traced by steps here and by calls there: without a GPU these two are compared.
"""

from __future__ import annotations

import numpy as np
import pytest

from djpt.geometry.engines import ray_queries
from djpt.validation import agreement
from tests.kit.devices import GRADIENTS, IMAGES, QUERIES, computed
from tests.kit.processes import run_python

pytestmark = [pytest.mark.cuda, pytest.mark.slow]


@pytest.fixture(scope="module")
def here() -> dict[str, np.ndarray]:
    """The results of this process."""
    with ray_queries("steps"):
        return computed()


@pytest.fixture(scope="module")
def on_cpu(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """The results of another process, on the CPU."""
    path = tmp_path_factory.mktemp("cpu") / "results.npz"
    done = run_python("-m", "tests.kit.devices", str(path), variant="llvm_ad_rgb", timeout=900)
    assert done.returncode == 0, done.stderr[-2000:]
    with np.load(path) as results:
        return dict(results)


def test_everything_is_compared(here: dict[str, np.ndarray], on_cpu: dict[str, np.ndarray]) -> None:
    assert set(here) == set(on_cpu) == {*IMAGES, *GRADIENTS, *QUERIES}


@pytest.mark.parametrize("name", IMAGES)
def test_images(name: str, here: dict[str, np.ndarray], on_cpu: dict[str, np.ndarray]) -> None:
    """Rounding flips a decision of a few paths: with 16 samples in a pixel, or 25 pixels per sample, it shows."""
    image, reference = here[name], on_cpu[name]
    assert image.shape == reference.shape
    assert np.isfinite(image).all()
    assert reference.std() > 0.01
    assert agreement(image, reference, 1e-3).share >= 0.95
    assert image.mean() == pytest.approx(reference.mean(), rel=0.01)


@pytest.mark.parametrize("name", GRADIENTS)
def test_gradients(name: str, here: dict[str, np.ndarray], on_cpu: dict[str, np.ndarray]) -> None:
    gradient, reference = here[name], on_cpu[name]
    largest = float(np.abs(reference).max())
    assert gradient.shape == reference.shape
    assert largest > 0
    assert np.mean(np.abs(gradient - reference) > 0.02 * largest) < 0.02
    total = float(reference.sum())
    assert float(gradient.sum()) == pytest.approx(total, rel=0.02, abs=0.02 * largest)


@pytest.mark.parametrize("name", QUERIES)
def test_ray_queries(name: str, here: dict[str, np.ndarray], on_cpu: dict[str, np.ndarray]) -> None:
    """Rays that graze an edge may go either way."""
    answer, reference = here[name], on_cpu[name]
    assert 0.05 < reference[0].mean() < 0.95
    same = (np.abs(answer.astype(np.float32) - reference) < 1e-3).all(axis=0)
    assert same.mean() > 0.999
