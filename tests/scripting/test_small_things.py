"""Constants, command lines, stopwatch, versions, numbers as text: as in Mitsuba."""

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


def test_a_command_line() -> None:
    parser = djpt.ArgParser()
    flag, number, long, rest = (
        parser.add("-a"),
        parser.add("-f", True),
        parser.add(["-l", "--long"], True),
        parser.add(""),
    )
    parser.parse(["program", "-aa", "-f0.25", "x", "--long", "34", "-l", "5"])
    assert parser.executable_name() == "program" and flag.count() == 2 and number.as_float() == 0.25
    assert bool(rest) and rest.as_string() == "x" and long.as_int() == 34 and long.next().as_int() == 5
    with pytest.raises(DjptError, match="the option -f needs a value"):
        parser.parse(["program", "-f"])
    with pytest.raises(DjptError, match="unknown argument '--other'; possible: -a, -f, -l/--long"):
        parser.parse(["program", "--other"])
    parser.parse(["program", "-f", "x"])
    with pytest.raises(RuntimeError, match="the option -f needs a number, found 'x'"):
        number.as_float()
    with pytest.raises(DjptError, match="the option -a wasn't given"):
        flag.as_string()


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
