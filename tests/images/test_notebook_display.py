"""What notebooks show: pictures of images and of comparisons, and bars. A small stand-in plays IPython."""

from __future__ import annotations

import base64
import io
import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import drjit as dr
import numpy as np
import pytest
from PIL import Image as Picture

import djpt
from djpt.apps.display import LEAST_SIZE, picture_of, show_images
from djpt.jit.types import Float, TensorXf
from djpt.rendering.progress import watched
from tests.kit.processes import run_python


def image(height: int = 12, width: int = 10, channels: int = 3) -> TensorXf:
    return TensorXf(np.random.default_rng(0).random((height, width, channels)).astype(np.float32))


class Shell:
    """A notebook's IPython: which functions are registered for which types, and what is displayed."""

    def __init__(self) -> None:
        self.kernel = object()
        self.registered: dict[tuple[str, str], Any] = {}
        self.pages: list[str] = []
        self.display_formatter = SimpleNamespace(formatters={"image/png": self})

    def for_type_by_name(self, module: str, name: str, function: Any) -> None:
        self.registered[module, name] = function

    def update(self, html: str) -> None:
        self.pages.append(html)

    def display(self, html: str, display_id: bool) -> Any:
        assert display_id
        self.update(html)
        return self


@pytest.fixture
def shell(monkeypatch: pytest.MonkeyPatch) -> Iterator[Shell]:
    found = Shell()
    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: found  # type: ignore[attr-defined]
    display.HTML, display.display = str, found.display  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    yield found


# ---------------------------------------------------------------- images


def test_the_class_of_images_gets_a_picture(shell: Shell) -> None:
    show_images()
    kind = TensorXf
    assert shell.registered[kind.__module__, kind.__name__] is picture_of


def test_importing_djpt_in_a_notebook_registers_it() -> None:
    code = """
import sys, types
from types import SimpleNamespace
names = []
png = SimpleNamespace(for_type_by_name=lambda module, name, function: names.append(module))
shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"image/png": png}))
sys.modules["IPython"] = types.ModuleType("IPython")
sys.modules["IPython"].get_ipython = lambda: shell
import djpt
print(names, "drjit" in sys.modules)
"""
    done = run_python("-c", code)
    assert done.stdout == "['drjit.llvm.ad', 'drjit.llvm', 'drjit.cuda.ad', 'drjit.cuda'] False\n", done.stderr


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 7])
def test_the_picture_is_that_of_an_image(channels: int) -> None:
    tensor = image(channels=channels)
    png = picture_of(tensor)
    assert png is not None
    # Of 12 x 10 pixels, each is a square of 21.
    shown = np.asarray(Picture.open(io.BytesIO(png)))
    found = shown[10::21, 10::21]
    np.testing.assert_array_equal(found.repeat(21, axis=0).repeat(21, axis=1), shown)
    np.testing.assert_array_equal(found.reshape(*found.shape[:2], -1), djpt.Image(tensor).srgb())


def test_large_images_keep_their_pixels() -> None:
    png = picture_of(image(height=200, width=130))
    assert png is not None
    assert Picture.open(io.BytesIO(png)).size == (130, 200)


def test_an_attached_image_stays_attached() -> None:
    amount = Float(2)
    dr.enable_grad(amount)
    tensor = image() * amount
    assert picture_of(tensor) == picture_of(TensorXf(dr.detach(tensor)))
    dr.backward(dr.sum(tensor, axis=None))
    assert amount.grad[0] == pytest.approx(image().numpy().sum(), rel=1e-5)


@pytest.mark.parametrize(
    "shape", [(40,), (16, 16), (4, 16, 16, 3), (LEAST_SIZE - 1, 16, 3), (16, LEAST_SIZE - 1, 3)], ids=str
)
def test_other_tensors_stay_numbers(shape: tuple[int, ...]) -> None:
    assert picture_of(dr.zeros(TensorXf, shape)) is None


def test_a_comparison_shows_its_picture_and_its_table() -> None:
    pytest.importorskip("mitsuba")
    result = djpt.validation.compare("cornell_box", spp=4, width=12, height=12, batches=2, same_seed_spp=0)
    assert Picture.open(io.BytesIO(result._repr_png_())).size[0] > 3 * 200
    page = result._repr_html_()
    assert page.startswith('<img src="data:image/png;base64,') and "RMSE" in page


# ---------------------------------------------------------------- bars


def small_box() -> djpt.Scene:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=8, height=8)
    return djpt.load_dict(description)


def test_a_bar_in_a_notebook(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("djpt.rendering.progress.INTERVAL", 0.0)
    with_bar = djpt.render(small_box(), spp=4, pass_spp=1, progress=True)
    first, *between, last = shell.pages
    assert first == 'rendering <progress value="0" max="1"></progress> 0%'
    assert len(between) == 4 and 'value="256" max="256"' in between[-1] and "samples/s, 0 s left" in between[-1]
    assert last == ""
    np.testing.assert_array_equal(with_bar.numpy(), djpt.render(small_box(), spp=4).numpy())


def test_a_bar_disappears_after_an_error(shell: Shell) -> None:
    with pytest.raises(djpt.RenderError):
        djpt.render(small_box(), spp=4, schedule="nonsense", progress=True)
    assert shell.pages[-1] == ""


def test_without_notebook_and_terminal_nothing_is_shown(capfd: pytest.CaptureFixture[str]) -> None:
    djpt.render(small_box(), spp=1, progress=True)
    assert capfd.readouterr() == ("", "")


def test_functions_are_called_as_they_are() -> None:
    calls = []
    with watched(lambda done, total: calls.append((done, total)), "counting", "steps") as show:
        assert show is not None
        show(1, 2)
    assert calls == [(1, 2)]
    with watched(False, "counting", "steps") as show:
        assert show is None
    with pytest.raises(djpt.RenderError, match="'progress' must be a function or True, found int"):
        djpt.render(small_box(), spp=1, progress=3)


# ---------------------------------------------------------------- renders in rounds


def rounds_of_box(count: int) -> Iterator[Any]:
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=12, height=12)
    return djpt.render_passes(djpt.load_dict(description), spp=4 * count, round_spp=4)


def test_a_render_in_rounds_is_shown_while_it_gets_better(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("djpt.apps.display.INTERVAL", 0.0)
    done = djpt.show_passes(rounds_of_box(3))
    assert done.spp == 12
    assert [page.partition("<figcaption>")[2].partition(" spp")[0] for page in shell.pages] == ["4", "8", "12", "12"]
    data = shell.pages[-1].partition("base64,")[2].partition('"')[0]
    with Picture.open(io.BytesIO(base64.b64decode(data))) as picture:
        assert picture.size == (252, 252)


def test_an_interrupted_render_gives_what_exists(shell: Shell) -> None:
    def interrupted() -> Iterator[Any]:
        yield next(rounds_of_box(1))
        raise KeyboardInterrupt

    assert djpt.show_passes(interrupted()).spp == 4
    with pytest.raises(djpt.RenderError, match="no rounds"):
        djpt.show_passes(iter(()))


def test_nothing_is_shown_without_a_notebook() -> None:
    assert djpt.show_passes(rounds_of_box(1)).spp == 4
