"""The page of a comparison in a browser: offline, linked, and small."""

from __future__ import annotations

import base64
import json
import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from djpt.errors import FileError
from djpt.images.image import write
from djpt.validation import Comparison, compare
from djpt.validation.page.writing import bytes_of, halves_of
from tests.kit.browser import CHROMIUM, Page, browsing

pytest.importorskip("scipy")
pytest.importorskip("flip_evaluator")

WIDTH, HEIGHT = 40, 30


def picture(spp: int, seed: int) -> np.ndarray:
    """A grey ramp with some noise: brighter to the right."""
    ramp = np.broadcast_to(np.linspace(0.1, 0.4, WIDTH)[:, None], (HEIGHT, WIDTH, 3))
    return (ramp * np.random.default_rng(seed).gamma(10 * spp, 0.1 / spp, ramp.shape)).astype(np.float32)


def spotted(spp: int, seed: int) -> np.ndarray:
    image = picture(spp, seed)
    image[13, 20] += 1
    return image


def result() -> Comparison:
    return compare(spotted, spp=32, against=picture, limits={"psnr": 10}, name="a <spot> & more")


def inflated(text: str, kind: str) -> np.ndarray:
    """The numbers that `packed` packed."""
    raw = np.frombuffer(zlib.decompress(base64.b64decode(text), -zlib.MAX_WBITS), np.uint8)
    size = np.dtype(kind).itemsize
    return np.ascontiguousarray(raw.reshape(size, -1).T).reshape(-1).view(kind).astype(np.float64)


# ---------------------------------------------------------------- the file


def test_numbers_survive_packing() -> None:
    values = np.array([[1e-9, -3e-9], [2e-10, 0.0]])
    stored = halves_of(values)
    np.testing.assert_allclose(inflated(stored["data"], "<f2") * stored["scale"], values.ravel(), rtol=1e-3)
    large = halves_of(np.array([1e6, 1.0]))
    np.testing.assert_allclose(inflated(large["data"], "<f2") * large["scale"], [1e6, 1.0], rtol=1e-3)
    assert halves_of(np.zeros(3))["scale"] == 1
    steps = inflated(bytes_of(np.array([-9.0, -6, 0, 6, 9]), -6, 6)["data"], "u1")
    assert steps.tolist() == [0, 0, 127, 254, 254]


def test_the_file_has_everything(tmp_path: Path) -> None:
    result().write_page(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text()
    assert "<h1>a &lt;spot&gt; &amp; more</h1>" in text and "FAILED" in text and "pixels: FAILED" in text
    for expected in ("PSNR", "SSIM", "HDR-FLIP", "the function spotted", "seeds", "drjit", "processor", "Deviates"):
        assert expected in text, expected
    assert not re.search(r"(src|href)=\"(?!data:)", text) and "http" not in text
    with pytest.raises(FileError, match="a page"):
        result().write_page(tmp_path / "a.png")


def test_images_without_noise_and_black_ones() -> None:
    from djpt.validation.page import html

    black = np.zeros((4, 5, 1), np.float32)
    text = html(compare(black, against=black))
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    assert data["z"] is None and data["width"] == 5
    assert "HDR-FLIP" not in text, "it finds its exposures from the reference"


NAMES = {
    "a script that is never closed": "<!--<script>.exr",
    "a script": "</script><script>document.title = 'owned'</script>.exr",
    "an attribute": "\"onload='x'&amp;.exr",
    "the end of the page": "--></main></body></html>.exr",
    "not UTF-8": "\udcff.exr",
}


def named(name: str, folder: Path) -> Comparison:
    """The comparison of a file of this name with itself."""
    write(folder / "plain.exr", picture(1, 0))
    found = compare(folder / "plain.exr", against=folder / "plain.exr", name=name)
    return replace(found, titles=(name, name), facts=({"file": name, name: {name: name}}, {}))


@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
def test_pages_survive_any_name(name: str, tmp_path: Path) -> None:
    """A page has two scripts, its data and its code; the parser of browsers has states of its own within them."""
    named(name, tmp_path).write_page(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text("utf-8")
    assert re.findall(r"</?script|<!--", text) == ["<script", "</script"] * 2
    block = re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1]  # type: ignore[index]
    assert "<" not in block
    assert json.loads(block)["titles"] == [name, name]
    assert text.endswith("</script>\n</body>\n</html>\n")


@pytest.mark.parametrize("size", [64, pytest.param(512, marks=pytest.mark.slow)])
def test_noisy_pages_are_small(size: int) -> None:
    """Noise can't be compressed: less than 5 MB for 512 x 512 pixels, and as much for each of others."""
    from djpt.validation.page import html

    def noise(spp: int, seed: int) -> np.ndarray:
        return np.random.default_rng(seed).gamma(0.5, 2, (size, size, 3)).astype(np.float32)

    found = compare(noise, spp=8, against=noise, batches=2, same_seed_spp=0)
    assert len(html(found)) - 40_000 < (5e6 - 40_000) * (size / 512) ** 2


# ---------------------------------------------------------------- in a browser


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("name", NAMES.values(), ids=NAMES)
@pytest.mark.sparse(5)
def test_pages_of_any_name_work(name: str, tmp_path: Path) -> None:
    named(name, tmp_path).write_page(tmp_path / "a.html")
    with browsing(tmp_path / "profile") as opened:
        opened.open((tmp_path / "a.html").as_uri())
        opened.wait("document.body.dataset.ready == 'yes'")
        assert opened.run("document.title") != "owned"
        assert opened.run('document.getElementById("title-a").textContent').endswith(".exr")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    if CHROMIUM is None:
        pytest.skip("no Chromium")
    folder = tmp_path_factory.mktemp("page")
    result().write_page(folder / "report.html")
    with browsing(folder / "profile") as opened:
        opened.open((folder / "report.html").as_uri())
        opened.wait("document.body.dataset.ready == 'yes'")
        yield opened


def colour(page: Page, name: str, column: int, row: int) -> list[int]:
    """The colour that a canvas shows for a pixel of the whole picture."""
    return page.run(
        f"""(() => {{
            const canvas = document.getElementById("{name}"), size = canvas.width / {WIDTH};
            const at = [({column} + 0.5) * size, ({row} + 0.5) * size].map(Math.floor);
            return Array.from(canvas.getContext("2d").getImageData(...at, 1, 1).data.slice(0, 3));
        }})()"""
    )


def choose(page: Page, name: str, value: Any) -> None:
    page.run(
        f"""(() => {{
            const control = document.getElementById("{name}");
            control.value = {value!r};
            control.dispatchEvent(new Event("input"));
        }})()"""
    )


def canvas(page: Page, name: str) -> str:
    return page.run(f'document.getElementById("{name}").toDataURL()')


def whole(page: Page) -> None:
    page.run('document.getElementById("reset").click()')


def corner(page: Page, name: str) -> tuple[float, float, float]:
    """The upper left corner of a canvas, and the size of a pixel of the whole picture, on the screen."""
    x, y, width = page.run(
        f'(({{x, y, width}}) => [x, y, width])(document.getElementById("{name}").getBoundingClientRect())'
    )
    return x, y, width / WIDTH


def wheel(page: Page, name: str, turn: float) -> None:
    x, y, size = corner(page, name)
    centre = {"x": x + WIDTH / 2 * size, "y": y + HEIGHT / 2 * size}
    page.call("Input.dispatchMouseEvent", type="mouseWheel", **centre, deltaX=0, deltaY=turn)


def test_nothing_is_requested_and_nothing_fails(page: Page) -> None:
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []
    assert len([url for url in page.requests if url.startswith("file:")]) == 1


def test_the_spot_is_red_and_the_images_are_right(page: Page) -> None:
    red, green, blue = colour(page, "c", 20, 13)
    assert red > 150 and green < 60 and blue < 80
    first, second = colour(page, "a", 20, 13), colour(page, "b", 20, 13)
    assert min(first) == 255 > 180 > max(second)
    expected = 255 * (1.055 * np.linspace(0.1, 0.4, WIDTH)[35] ** (1 / 2.4) - 0.055)
    assert np.abs(np.array(colour(page, "b", 35, 20)) - expected).max() < 8


def test_exposure_and_false_colours_change_both_images(page: Page) -> None:
    before = {name: canvas(page, name) for name in "abc"}
    choose(page, "exposure", "-2")
    assert [canvas(page, name) != before[name] for name in "abc"] == [True, True, False]
    assert max(colour(page, "b", 35, 20)) < 100
    choose(page, "exposure", "0")
    assert {name: canvas(page, name) for name in "abc"} == before
    choose(page, "colours", "false")
    grey = colour(page, "a", 5, 5)
    assert max(grey) - min(grey) > 60
    choose(page, "colours", "srgb")


def test_the_third_picture_and_its_scale(page: Page) -> None:
    seen = {}
    for kind in ("signed", "relative", "z", "flip"):
        choose(page, "third", kind)
        seen[kind] = canvas(page, "c")
    assert len(set(seen.values())) == 4
    choose(page, "third", "z")
    assert colour(page, "c", 20, 13) == [178, 24, 43], "z is beyond the full scale"
    choose(page, "third", "signed")
    choose(page, "scale", "6")
    paler = colour(page, "c", 20, 13)
    choose(page, "scale", "0")
    assert paler[1] > colour(page, "c", 20, 13)[1]


def test_zoom_and_pan_are_linked(page: Page) -> None:
    before = {name: canvas(page, name) for name in "abc"}
    wheel(page, "a", -480)
    page.wait("view.zoom > 3.9")
    zoomed = {name: canvas(page, name) for name in "abc"}
    assert all(zoomed[name] != before[name] for name in "abc")
    # The spot, left above the centre, lies at the same place of all three pictures.
    x, y = page.run("[view.x, view.y]")
    place = [int((20.5 - x) * 4), int((13.5 - y) * 4)]
    assert min(colour(page, "a", *place)) == 255 and colour(page, "c", *place)[1] < 60
    assert max(colour(page, "b", *place)) < 180
    left, top, _ = corner(page, "c")
    page.drag((left + 100, top + 100), (left + 60, top + 80))
    page.wait(f"view.x > {x} && view.y > {y}")
    assert all(canvas(page, name) != zoomed[name] for name in "abc")
    whole(page)
    assert {name: canvas(page, name) for name in "abc"} == before


def test_the_pixel_below_the_pointer_is_told(page: Page) -> None:
    left, top, size = corner(page, "b")
    page.mouse("mouseMoved", left + 20.5 * size, top + 13.5 * size)
    page.wait('document.getElementById("pixel").textContent.includes("(20, 13)")')
    text = page.run('document.getElementById("pixel").textContent')
    assert "spotted 1." in text and "z 6.00" in text and "FLIP" in text
