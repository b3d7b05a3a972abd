"""No flag of Dr.Jit ends the process, and what can't be rendered under one is refused."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import drjit as dr
import pytest

from tests.fuzz.cases import Case
from tests.fuzz.pool import Pool

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the limits are those of Unix")

PROGRAM = """
with dr.scoped_set_flag(dr.JitFlag.{name}, not dr.flag(dr.JitFlag.{name})):
    film = {{'type': 'hdrfilm', 'width': 4, 'height': 4}}
    scene = djpt.load_dict({{'type': 'scene', 'shape': {{'type': 'sphere'}}, 'light': {{'type': 'constant'}},
        'integrator': {{'type': 'path', 'max_depth': 3}}, 'sensor': {{'type': 'perspective', 'film': film}}}})
    image = djpt.render(scene, spp=2)
"""
REFUSED = ("SymbolicScope", "Recording")
"""Flags that Dr.Jit sets where nothing can be computed."""


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool(seconds=120) as made:
        yield made


def check(pool: Pool, name: str) -> None:
    verdict = pool.run(Case(PROGRAM.format(name=name), finite=True))
    assert verdict.outcome == ("refused" if name in REFUSED else "fine"), verdict


@pytest.mark.parametrize("name", ["SymbolicScope", "SymbolicLoops", "ForbidSynchronization"])
@pytest.mark.sparse(4)
def test_flags_that_change_most(pool: Pool, name: str) -> None:
    check(pool, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(dr.JitFlag.__members__))
def test_all_flags(pool: Pool, name: str) -> None:
    check(pool, name)
