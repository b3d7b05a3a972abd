"""Tables over grids: compiled functions and NumPy build the same, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from djpt.distributions import Hierarchical2D, grids
from djpt.distributions.grids import PARAMETERS, add_grid_functions
from djpt.jit.llvm.host import HostFunctions


def both(monkeypatch: pytest.MonkeyPatch, build: Callable[[], Any]) -> list[Any]:
    """What is built by compiled functions, and by NumPy."""
    results = []
    for small in (0, 1 << 60):
        functions = HostFunctions(add_grid_functions, PARAMETERS, small, few=1 << 60)
        monkeypatch.setattr(grids, "FUNCTIONS", functions)
        results.append(build())
    return results


SIZES = [(1, 1), (1, 5), (4, 1), (2, 2), (7, 9), (33, 64)]


def test_functions_can_be_compiled_here() -> None:
    assert grids.FUNCTIONS.for_size(1 << 20) is not None


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("share_of_zeros", [0.0, 0.6])
def test_densities_over_grids(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int], share_of_zeros: float) -> None:
    rng = np.random.default_rng(size)
    numbers = rng.random((size[0] + 1, size[1] + 1)) ** 5
    numbers[rng.random(numbers.shape) < share_of_zeros] = 0
    numbers[0, 0] = 1

    def build() -> list[bytes]:
        density = Hierarchical2D()
        density.set(numbers)
        found = (density.splits, density.corners, *density.root, density.at_corners)
        return [np.array(array).tobytes() for array in found]

    compiled, plain = both(monkeypatch, build)
    assert compiled == plain


@pytest.mark.parametrize("size", SIZES)
def test_texels(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    # As in environment maps, rows have a column more at each end.
    texels = (rng.random((size[0], size[1] + 2, 3), np.float32) * 40 - 1)[:, 1:-1]
    numbers = rng.random((size[0], size[1] + 1))[:, :-1]
    for build in (lambda: grids.luminance(texels), lambda: grids.side_by_side(texels, numbers)):
        compiled, plain = both(monkeypatch, build)
        assert compiled.dtype == plain.dtype
        assert compiled.tobytes() == plain.tobytes()
    assert (grids.luminance(texels[..., :1]) == np.maximum(texels[..., 0], 0)).all()
