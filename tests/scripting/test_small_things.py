"""Constants, stopwatch, versions, numbers as text: as in Mitsuba."""

from __future__ import annotations

from typing import Any

import pytest

import djpt
from djpt.errors import DjptError
from djpt.mitsuba import constants

TIMES = [0, 0.5, 1, 999, 1000, 2010, 65_000, 4e6, 2e8, 1e9, 1e11]
SIZES = [0, 1, 1023, 1024, 5000, 2**20, 2**30 - 1, 3 * 2**40, 2**60]


@pytest.mark.parametrize("name", sorted(set(constants.__all__) - {"MI_ENABLE_EMBREE"}))
def test_constants(name: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    assert getattr(djpt, name) == getattr(mi, name)


@pytest.mark.parametrize("precise", [False, True])
@pytest.mark.parametrize(
    ("function", "value"), [*(("time_string", t) for t in TIMES), *(("mem_string", s) for s in SIZES)]
)
def test_text(function: str, value: Any, precise: bool) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    assert getattr(djpt.misc, function)(value, precise) == getattr(mi.misc, function)(value, precise)


@pytest.mark.parametrize(
    ("name", "instead"),
    [("ArgParser", "argparse"), ("Spiral", "djpt.render_passes"), ("Loop", "while")],
)
def test_names_that_are_left_out_say_what_to_use(name: str, instead: str) -> None:
    with pytest.raises(AttributeError, match=f"is left out: .*`{instead}`"):
        getattr(djpt, name)


def test_versions() -> None:
    assert djpt.Version(3, 9, 1) == djpt.Version(value=djpt.MI_VERSION) == djpt.Version("3.9.1") > djpt.Version()
    assert str(djpt.Version(3, 10, 0)) == "3.10.0" and djpt.Version(3, 10, 0) > djpt.Version(3, 9, 1)
    with pytest.raises(DjptError, match="three numbers"):
        djpt.Version("3.9")


def test_a_stopwatch(capsys: pytest.CaptureFixture[str]) -> None:
    timer = djpt.Timer()
    timer.begin_stage("reading")
    timer.end_stage("reading")
    assert capsys.readouterr().out.startswith("reading: took ")
    assert timer.reset() >= 0 and timer.value() < 1000
    with pytest.raises(DjptError, match="'writing' hasn't begun"):
        timer.end_stage("writing")


@pytest.mark.parametrize("name", ["sphere", "rectangle", "cube", "disk", "cylinder"])
def test_a_lone_shape_has_the_parameters_of_mitsubas(mi: Any, name: str) -> None:
    """That of the material it gets if it has none, too."""
    ours, theirs = (m.traverse(m.load_dict({"type": name})) for m in (djpt, mi))
    assert set(ours.keys()) == set(theirs.keys())
    ours["bsdf.reflectance.value"] = djpt.Color3f(0.1, 0.2, 0.3)
    ours.update()
