"""Searches that are seen while they run: in notebooks, which a small stand-in plays, and in terminals."""

from __future__ import annotations

import io
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import djpt
from djpt.apps.optimization import Progressed, optimize
from djpt.apps.optimization.live import LiveSearch, curve, sparkline
from tests.optimization.test_optimize import KEY, floor, grey, pictures


def test_a_notebook_shows_loss_parameters_and_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    pages: list[str] = []
    place = SimpleNamespace(update=pages.append)

    def shown(page: str, display_id: bool) -> SimpleNamespace:
        pages.append(page)
        return place

    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(kernel=object())  # type: ignore[attr-defined]
    display.HTML = str  # type: ignore[attr-defined]
    display.display = shown  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.setattr("djpt.optimization.live.INTERVAL", 0.0)
    scene = floor()
    optimize(grey(scene), KEY, pictures(scene, 4), iterations=3, spp=1, live=True)
    # One for each iteration, and the last again.
    assert len(pages) == 4 and "iteration 3, loss" in pages[-1] and pages[-1] == pages[-2]
    assert KEY in pages[0] and pages[0].count("<img") == 4
    assert [page.count(",", page.index("points="), page.index(" fill=")) for page in pages] == [1, 2, 3, 3]


def test_textures_are_shown_as_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    from djpt.apps.optimization.live import markup

    done = Progressed(0, 0.1, {"a<b": djpt.TensorXf(np.full((8, 8, 3), 0.5, np.float32))}, 0.0)
    page = markup(done, [0.1])
    assert "a&lt;b" in page and "192 numbers from 0.5 to 0.5" in page and page.count("<img") == 1


def test_a_terminal_shows_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with LiveSearch([4.0]) as shows:
        for i, loss in enumerate((2.0, 1.0)):
            shows(Progressed(i, loss, {}, 0.0))
    assert terminal.getvalue().endswith("\r2 █▅▁ loss 1\033[K\n")


def test_elsewhere_nothing_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with LiveSearch() as shows:
        shows(Progressed(0, 1.0, {}, 0.0))
    assert capsys.readouterr() == ("", "")


def test_losses_of_any_sort_are_drawn() -> None:
    assert sparkline([100.0, 10.0, 1.0]) == "█▅▁"
    assert sparkline([1.0, float("nan"), 0.1, 0.0]) == "██▁▁"
    assert sparkline([]) == "" and sparkline([-1.0, 0.0]) == "▁▁"
    assert "points=" in curve([1.0, float("inf"), 0.5])
