"""The comparison of Mitsuba's names with djpt's: the rules, and the record of what is here."""

from __future__ import annotations

import enum
import inspect
import subprocess
import sys
from dataclasses import dataclass
from fnmatch import fnmatchcase
from types import ModuleType, SimpleNamespace
from typing import Any, overload

import pytest

import djpt
from djpt.core.forms import forms
from djpt.mitsuba.names import REASONS
from djpt.validation.names import Finding, Verdict, counts, findings, read_names, render_page
from djpt.validation.names.__main__ import PAGE
from djpt.validation.names.compare import MISSING, look_up, parse, refused_call, signatures

reads_overloads = pytest.mark.skipif(sys.version_info < (3, 11), reason="overloads can be read from Python 3.11 on")


def refused(theirs: str, ours: str) -> str | None:
    return refused_call([parse(theirs)], [parse(ours)])


@pytest.mark.parametrize(
    ("theirs", "ours", "call"),
    [
        ("def f(a: int, b: mitsuba.Point3f = \\0) -> None", "def f(a, b=0, c=0)", None),
        ("def f(a, b=0)", "def f(a)", "(a, b)"),
        ("def f(a, b=0)", "def f(a, c=0)", "(a=, b=)"),
        ("def f(a, b)", "def f(a, b, c)", "(a, b)"),
        ("def f(a)", "def f(a, b)", "(a)"),
        ("def f(a)", "def f(*args, **kwargs)", "(a=)"),
        ("def f(arg: ndarray[dtype=float32, shape=(3, 3)], /)", "def f(*args)", None),
        ("def f(arg0: int, b: int)", "def f(x, b)", None),
        ("def f(a, *, b)", "def f(a, b)", None),
        ("def f(a)", "def f(a, /)", "(a=)"),
    ],
)
def test_a_call_that_is_refused_is_named(theirs: str, ours: str, call: str | None) -> None:
    assert refused(theirs, ours) == call


def test_every_overload_must_be_accepted() -> None:
    both = [parse("def f(self)"), parse("def f(self, x: float)")]
    assert refused_call(both, [parse("def f(self)")]) == "(self, x)"
    assert refused_call(both, both) is None


def test_the_object_of_a_method_is_no_argument() -> None:
    class Thing:
        def method(self, x: int) -> None: ...

    assert [str(s) for s in signatures(Thing.method, bound=True)] == ["(x: 'int') -> 'None'"]


class Colour(enum.IntEnum):
    RED = 1
    BLUE = 2


def module(**names: Any) -> ModuleType:
    """A module that looks like Mitsuba's."""
    made = ModuleType("mitsuba")
    for name, value in names.items():
        if inspect.isclass(value) or inspect.isfunction(value):
            value.__module__ = "mitsuba"
        setattr(made, name, value)
    return made


def verdicts(found: list[Finding]) -> dict[str, str]:
    return {f.name.path: f.verdict.value for f in found}


def test_each_verdict() -> None:
    class Ray:
        def __init__(self, o: int, time: int = 0) -> None: ...

        def at(self, t: int) -> int:
            return t

        @property
        def o(self) -> int:
            return 0

        @property
        def d(self) -> int:
            return 0

    @dataclass
    class Ours:
        o: int
        time: int = 0

        def at(self) -> int:
            return 0

        def d(self) -> int:
            return 0

    class Hue(enum.IntEnum):
        RED = 1
        BLUE = 3

    theirs = module(Ray=Ray, Colour=Colour, VERSION=3, mueller=lambda: 0, gone=lambda: 0)
    ours = SimpleNamespace(Ray=Ours, Colour=Hue, VERSION=4)
    assert verdicts(findings(theirs, ours)) == {
        "Ray": "here",
        "Ray.at": "different",
        "Ray.d": "different",
        "Ray.o": "here",
        "Colour": "here",
        "Colour.RED": "here",
        "Colour.BLUE": "different",
        "VERSION": "different",
        "mueller": "left out",
        "gone": "absent",
    }


def test_a_page_can_be_read_back() -> None:
    found = findings(module(Colour=Colour, VERSION=3), SimpleNamespace(Colour=Colour, VERSION=3))
    assert read_names(render_page(found)) == ["Colour", "VERSION", "Colour.RED", "Colour.BLUE"]


def test_every_name_on_the_page_resolves() -> None:
    """Without Mitsuba: a name that was here and is gone is a broken promise."""
    names = read_names(PAGE.read_text())
    assert len(names) > 100
    assert [name for name in names if look_up(djpt, name) is MISSING] == []


@pytest.fixture(scope="module")
def found() -> list[Finding]:
    djpt.types  # noqa: B018  (LLVM is chosen before Mitsuba loads Dr.Jit)
    mitsuba = pytest.importorskip("mitsuba")
    if djpt.variant() != "llvm_ad_rgb":
        pytest.skip("the table is that of llvm_ad_rgb")
    mitsuba.set_variant("llvm_ad_rgb")
    return findings(mitsuba, djpt)


@pytest.fixture(scope="module")
def page(found: list[Finding]) -> str:
    """The page as a process of its own makes it: modules that other tests have imported or replaced count, too."""
    done = subprocess.run([sys.executable, "-c", RENDERED], capture_output=True, text=True, check=True)
    return done.stdout


RENDERED = """
import djpt, sys
import djpt.jit.types, mitsuba
from djpt.validation.names import findings, render_page
mitsuba.set_variant("llvm_ad_rgb")
sys.stdout.write(render_page(findings(mitsuba, djpt)))
"""


@reads_overloads
def test_no_name_has_gone(page: str) -> None:
    assert sorted(set(read_names(PAGE.read_text())) - set(read_names(page))) == []


@reads_overloads
def test_the_page_is_up_to_date(page: str) -> None:
    """`python -m djpt.validation.names --write` renews it."""
    assert PAGE.read_text() == page


def test_every_reason_is_needed(found: list[Finding]) -> None:
    excluded = [f.name.path for f in found if f.verdict is Verdict.EXCLUDED]
    assert counts(found)[Verdict.EXCLUDED] == len(excluded)
    assert [pattern for pattern in REASONS if not any(fnmatchcase(path, pattern) for path in excluded)] == []


@reads_overloads
def test_forms_and_overloads_are_read() -> None:
    @forms("a b", "a c | d")
    def function(*, a: int, b: int = 0, c: int = 0, d: int = 0) -> None: ...

    class Thing:
        @overload
        def __init__(self, x: int) -> None: ...
        @overload
        def __init__(self, y: str, z: int) -> None: ...
        def __init__(self, *arguments: Any, **named: Any) -> None: ...

    assert [str(s) for s in signatures(function, bound=False)] == ["(a, b)", "(a, c, d=None)"]
    assert [len(s.parameters) for s in signatures(Thing, bound=False)] == [1, 2]
