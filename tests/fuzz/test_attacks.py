"""Random attacks: nothing aborts, hangs or fills the memory, and every error is a `DjptError` that names its cause."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from tests.fuzz.families import FAMILIES, WEIGHTS
from tests.fuzz.pool import Pool
from tests.fuzz.rounds import attack

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the limits are those of Unix")

FEW = 3
"""Times the weights of families, the number of cases in a short run."""

MANY = 30


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool() as made:
        yield made


@pytest.mark.parametrize("family", [name for name in FAMILIES if name != "images"])
@pytest.mark.sparse(9)
def test_djpt_survives(pool: Pool, family: str) -> None:
    assert attack(pool, family, 0, FEW * WEIGHTS[family], set()) is None


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_djpt_survives_more(pool: Pool, family: str) -> None:
    assert attack(pool, family, 1, MANY * WEIGHTS[family], set()) is None
