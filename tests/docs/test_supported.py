"""The table of plugins says what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from djpt.description.registry import is_own, registered
from tests.kit.processes import ROOT

PAGE = ROOT / "docs" / "supported.md"

pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="not a working copy of the repository")

KINDS = {
    "Shapes": ["shape"],
    "Materials": ["bsdf"],
    "Lights": ["emitter"],
    "Cameras": ["sensor"],
    "Samplers": ["sampler"],
    "Films, filters": ["film", "rfilter"],
    "Integrators": ["integrator"],
    "Phase functions, volumes": ["phase", "volume"],
}


@pytest.mark.parametrize("row", [*KINDS, "Textures", "Media"])
def test_the_table_of_plugins_is_true(row: str) -> None:
    line = next(x for x in PAGE.read_text().splitlines() if re.match(rf"\| \[?{row}\b", x))
    both, only_here, missing = (set(re.findall(r"`(\w+)`", cell)) for cell in line.strip("|").split("|")[1:])
    assert both | only_here <= set(registered())
    assert not missing & set(registered())
    if row in KINDS:
        own = [name for kind in KINDS[row] for name, factory in registered(kind).items() if is_own(factory)]
        assert both | only_here == set(own)
    mitsuba = pytest.importorskip("mitsuba")
    theirs = {path.stem for path in (Path(mitsuba.__file__).parent / "plugins").iterdir()}
    # Some of its integrators are in Python.
    in_python = {"prb", "prb_basic", "prbvolpath", "direct_projective", "prb_projective", "volprim_rf_basic"}
    assert both - in_python <= theirs
    assert missing <= theirs and not only_here & theirs
