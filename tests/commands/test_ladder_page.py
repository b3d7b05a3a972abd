"""The page that compares all integrators, and the commands that write it."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from collections import Counter
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.description.registry import registered
from djpt.images.image import read_pixels
from djpt.validation.integrator_comparison.measure import (
    Budget,
    Ladder,
    Reference,
    error_floor,
    measure,
    shared_error,
)
from djpt.validation.integrator_comparison.page import html
from djpt.validation.integrator_comparison.steps import ELSEWHERE, STEPS
from tests.kit.commands import run

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

VOID = {"meta", "img", "input", "link"}

SPP = 16


def step(title: str) -> Any:
    return next(step for step in STEPS if step.title == title)


class Page(HTMLParser):
    """Tags in order, and whether they are balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    return measure("cornell_box", spp=SPP, width=16, reference_spp=2048)


@pytest.fixture(scope="module")
def text(ladder: Ladder) -> str:
    return html(ladder)


# ---------------------------------------------------------------- measuring


def test_every_integrator_is_a_step_or_said_to_be_none() -> None:
    own = {name for name, factory in registered("integrator").items() if factory.__module__.startswith("djpt.")}
    assert {step.type for step in STEPS} | ELSEWHERE.keys() == own
    assert max(Counter(step.title for step in STEPS).values()) == 1


@pytest.mark.slow
def test_all_steps_are_measured_at_powers_of_two(ladder: Ladder) -> None:
    assert [found.step for found in ladder.measured] == list(STEPS)
    assert ladder.refused == ()
    for found in ladder.measured:
        assert [point.spp for point in found.points] == [1, 2, 4, 8, 16]
        assert found.samples == SPP * 16 * 16 and found.speed > 0


@pytest.mark.slow
def test_errors_fall_but_for_what_is_left_out(ladder: Ladder) -> None:
    by_title = {found.step.title: found for found in ladder.measured}
    for title in ("path", "path_nee", "path_naive, cosine"):
        first, last = by_title[title].points[0], by_title[title].last
        assert 1.8 < first.rmse / last.rmse < 9  # 4 is expected
        assert not by_title[title].at_floor
        assert by_title[title].missing == ""
        assert abs(by_title[title].bias) < 5 * by_title[title].bias_error
    raycast = by_title["raycast"]
    assert raycast.at_floor and raycast.floor == pytest.approx(raycast.last.rmse, rel=0.05)
    assert math.isinf(raycast.seconds_to(by_title["path"].last.rmse))
    assert by_title["distributed"].missing == "paths of more than 3 edges"
    assert by_title["direct"].bias < -5 * by_title["direct"].bias_error


def test_what_is_left_out_depends_on_the_scene() -> None:
    description = djpt.cornell_box()
    description["lamp"] = {"type": "point", "position": [0, 0.5, 0]}
    scene = djpt.load_dict(description)
    assert "point" in step("path_naive, cosine").missing(scene)
    assert step("path").missing(scene) == step("ptracer").missing(scene) == ""
    description["white"] = {"type": "conductor"}
    scene = djpt.load_dict(description)
    assert "caustics" in step("path").missing(scene)
    assert "mirror" in step("ptracer").missing(scene)


def test_steps_are_as_deep_as_the_scene_asks_for() -> None:
    scene = djpt.load_dict(
        {**djpt.cornell_box(), "integrator": {"type": "path", "max_depth": 5, "hide_emitters": True}}
    )
    assert step("path").description(scene)["max_depth"] == 5
    assert step("distributed").description(scene)["max_depth"] == 3
    assert step("raycast").description(scene) == {"type": "raycast", "hide_emitters": True}
    scene = djpt.load_dict({**djpt.cornell_box(), "integrator": {"type": "path", "max_depth": 2}})
    assert step("distributed").missing(scene) == ""


FEW = ("path_naive, cosine", "whitted", "path", "ptracer")
"""Steps that say much, since every step compiles kernels of its own: the first one, a refused one, and two ways."""


@pytest.fixture(params=[pytest.param(FEW, id="few"), pytest.param(None, id="all", marks=pytest.mark.slow)])
def count(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """The number of steps that are measured."""
    steps = STEPS if request.param is None else tuple(step for step in STEPS if step.title in request.param)
    monkeypatch.setattr("djpt.validation.integrator_comparison.measure.STEPS", steps)
    return len(steps)


def test_refused_integrators_are_named_with_the_reason(count: int) -> None:
    scene = djpt.cornell_box()
    del scene["light"]
    scene["sky"] = {"type": "constant"}
    found = measure(scene, spp=2, width=4)
    assert len(found.measured) == count - 1
    assert [no.step.title for no in found.refused] == ["whitted"]
    assert "can't light a scene by its environment alone" in found.refused[0].reason
    assert "can&#x27;t light a scene by its environment alone" in html(found)
    assert found.name == "scene"


def test_time_is_used_up() -> None:
    """Of a renderer that takes 1 s and 0.1 s per sample, 4.1 s are 31 samples."""
    spent: list[float] = []
    counts = []
    for spp in Budget(4.1, None, 10**6).counts(lambda: spent[-1]):
        counts.append(spp)
        spent.append(1 + 0.1 * spp)
    assert counts[:5] == [1, 2, 4, 8, 16] and counts == sorted(set(counts))
    assert 4.1 / 1.3 < spent[-1] <= 4.1
    assert list(Budget(1.0, None, 10**6).counts(lambda: 5.0)) == [1]
    assert list(Budget(1.0, None, 3).counts(lambda: 0.1)) == [1, 2, 3]
    assert list(Budget(1.0, 100, 10**6).counts(lambda: 1e9)) == [1, 2, 4, 8, 16, 32, 64, 100]


def test_the_noise_of_the_reference_is_taken_out() -> None:
    random, shape = np.random.default_rng(1), (64, 64, 3)
    truth = random.random(shape)

    def noisy(deviation: float) -> Any:
        return truth + deviation * random.standard_normal(shape)

    goal = Reference("path", "", noisy(0.05), 0.05**2, 0.0, 1, 1.0, 0.0, ())
    a, b = noisy(0.1), noisy(0.2)
    assert shared_error(a, a, goal) == pytest.approx(0.1, rel=0.05)
    assert error_floor(a, b, (4, 1), goal) == 0
    assert error_floor(a + 0.1, b + 0.1, (4, 1), goal) == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_seeds_change_the_images_and_nothing_else(count: int) -> None:
    """Reference and images come from different seeds, or the error would be too small."""
    again = measure("cornell_box", spp=1, width=8, reference_spp=16)
    other = measure("cornell_box", spp=1, width=8, reference_spp=16, seed=1)
    same = measure("cornell_box", spp=1, width=8, reference_spp=16)
    for one, two, three in zip(again.measured, same.measured, other.measured, strict=True):
        np.testing.assert_array_equal(one.image, two.image)
        assert not np.array_equal(one.image, three.image)
    assert math.isnan(again.measured[0].bias_error)
    assert html(again).count("<tr>") == 1 + count


@pytest.mark.slow
def test_mitsuba_as_the_reference() -> None:
    pytest.importorskip("mitsuba")
    found = measure("cornell_box", spp=64, width=16, reference="mitsuba")
    path = next(f for f in found.measured if f.step.title == "path")
    assert found.reference.title == "path, Mitsuba"
    assert abs(path.bias) < 5 * path.bias_error and not path.at_floor


# ---------------------------------------------------------------- the page


@pytest.mark.slow
def test_the_page_is_balanced_and_needs_nothing_else(text: str) -> None:
    page = Page(text)
    assert page.open == []
    assert text.startswith("<!doctype html>")
    for _, attributes in page.tags:
        for key in ("src", "href"):
            assert (attributes.get(key) or "data:").startswith("data:")
    assert "http:" not in text and "https:" not in text and "@import" not in text and "url(" not in text
    assert [link["href"] for link in page.named("link")] in ([], ["data:,"])
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))


@pytest.mark.slow
def test_every_picture_has_an_alternative_text(text: str) -> None:
    page = Page(text)
    pictures = page.named("img")
    assert len(pictures) == 1 + 2 * len(STEPS) + 1  # the reference; images and errors; the scale
    assert all(picture["alt"] for picture in pictures)
    assert len({picture["src"] for picture in pictures}) == len(pictures)
    assert all(figure["aria-label"] for figure in page.named("svg"))


@pytest.mark.slow
def test_every_integrator_is_in_pictures_curves_and_numbers(text: str) -> None:
    rows = re.findall(r"<tr><td>.*?</span>(.*?)</td>", text)
    assert rows == [step.title for step in STEPS]
    assert re.findall(r'data-step="\d+" data-title="(.*?)"', text) == rows
    curves = re.findall(r'<g class="curve color\d+" data-title="(.*?)">(.*?)</g>', text)
    assert Counter(title for title, _ in curves) == dict.fromkeys(rows, 2)
    for _, body in curves:
        assert body.count("<circle") == 5  # 1, 2, 4, 8, 16 spp
    numbers = re.findall(r"<tr>(<td>.*?)</tr>", text)
    assert {row.count("<td") for row in numbers} == {text.count('<th scope="col"')}


@pytest.mark.slow
def test_what_the_reference_leaves_out_is_said(ladder: Ladder, text: str) -> None:
    assert ladder.reference.missing == ""
    lacking = html(replace(ladder, reference=replace(ladder.reference, missing="caustics")))
    assert lacking.count("Leaves out caustics.") == text.count("Leaves out caustics.") + 1


@pytest.mark.slow
def test_names_are_escaped(ladder: Ladder) -> None:
    text = html(replace(ladder, name='<script src="x">'))
    assert "<script src" not in text
    assert Page(text).open == []


@pytest.mark.sparse(2)
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome on PATH")
@pytest.mark.slow
def test_the_page_in_a_browser(text: str, scheme: str, tmp_path: Path) -> None:
    """At 400 pixels: nothing stands out at the side, all images load, the dialog opens, the console stays empty."""
    inside = """<script>
    const errors = [];
    addEventListener("error", (event) => errors.push(event.message || event.target.tagName), true);
    </script></head>"""
    probe = """<script>addEventListener("load", () => {
    const card = document.querySelectorAll(".cards.pictures button")[7];
    const page = document.documentElement, overflow = page.scrollWidth - page.clientWidth;
    const loaded = [...document.images].map((image) => image.naturalWidth > 0);
    card.click();
    document.querySelector(".choice [value=errors]").click();
    document.querySelector("[value=next]").click();
    const dialog = document.getElementById("compare");
    const box = dialog.getBoundingClientRect();
    parent.document.title = JSON.stringify([innerWidth, overflow, loaded.length, loaded.every(Boolean), dialog.open,
        dialog.querySelector("strong").textContent, dialog.querySelectorAll(".stack img").length,
        box.left >= 0 && box.right <= innerWidth, getComputedStyle(document.body).backgroundColor, errors]);
    });</script></body>"""
    framed = text.replace("</head>", inside).replace("</body>", probe)
    host = tmp_path / "host.html"
    host.write_text(f'<body><iframe width="400" height="800" style="border: 0" srcdoc="{escape(framed)}"></iframe>')
    (tmp_path / "page.html").write_text(text)
    dark = [] if scheme == "light" else ["--blink-settings=preferredColorScheme=0"]
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", *dark]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=5000"]
    done = run_browser([*command, "--dump-dom", host.as_uri()])
    assert "CONSOLE" not in done.stderr
    found = re.search(r"<title>(.*?)</title>", done.stdout)
    assert found, done.stdout[-2000:]
    paper = {"light": "rgb(250, 250, 248)", "dark": "rgb(21, 21, 23)"}[scheme]
    count = 2 + 2 * len(STEPS)
    expected = f'[400,0,{count},true,true,"path | error",2,true,"{paper}",[]]'
    assert found[1] == expected
    picture = tmp_path / "page.png"
    run_browser([*command, "--window-size=1000,1400", f"--screenshot={picture}", (tmp_path / "page.html").as_uri()])
    assert read_pixels(picture).shape == (1400, 1000, 3)
    assert len(np.unique(read_pixels(picture).reshape(-1, 3), axis=0)) > 200


def run_browser(command: list[str]) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done


# ---------------------------------------------------------------- on the command line


@pytest.mark.slow
def test_the_commands_write_what_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run("ladder", "cornell_box", "--time", "0.01", "--size", "8")
    assert (code, err) == (ExitCode.DONE, "")
    assert out.endswith("page: ladder.html\n") and len(out.splitlines()) == len(STEPS) + 1
    assert Page(Path("ladder.html").read_text()).open == []
    assert "<h1>cornell_box</h1>" in Path("ladder.html").read_text()
    code, out, _ = run("bounces", "cornell_box", "--max-depth", "3", "--spp", "2", "--size", "8", "--exposure", "auto")
    assert code == ExitCode.DONE and out.startswith("bounces.png: 4 pictures of 8 x 8, ")
    code, out, _ = run("strategies", "cornell_box", "--max-depth", "2", "--spp", "2", "--size", "8")
    assert code == ExitCode.DONE and out.startswith("strategies.png: 6 pictures of 8 x 8, ")
    assert read_pixels("bounces.png").shape[2] == 3
    code, out, _ = run("spp", "cornell_box", "--most", "16", "--size", "8", "--integrator", "path_nee", "-o", "a.jpg")
    assert code == ExitCode.DONE and out.startswith("a.jpg: 2 pictures of 8 x 8, ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ladder", "cornel_box"], "did you mean 'cornell_box'?"),
        (["ladder", "cornell_box", "--reference", "mitsubar"], "did you mean 'mitsuba'?"),
        (["ladder", "cornell_box", "--time", "0"], "'seconds' must be greater than 0, found 0.0"),
        (["ladder", "cornell_box", "--spp", "0"], "--spp must be at least 1, found 0"),
        (
            ["ladder", "cornell_box", "-o", "a.png"],
            "can't write 'a.png': the comparison of algorithms is a page, .html",
        ),
        (["ladder", "cornell_box", "-o", "no/a.html"], "can't write 'no/a.html': there is no folder '"),
        (
            ["bounces", "cornell_box", "-o", "a.exr"],
            "a strip has labels, so it is written as png or jpg, found 'a.exr'",
        ),
        (["bounces", "cornell_box", "--max-depth", "99"], "needs a 'max_depth' from 1 to 32, found 99"),
        (["strategies", "cornell_box", "--max-depth", "9"], "needs a 'max_depth' from 2 to 8, found 9"),
        (["bounces", "cornell_box", "--exposure", "much", "--size", "4"], "found 'much'"),
        (["spp", "cornell_box", "--integrator", "paht"], "did you mean 'path'?"),
        (["spp", "cornell_box", "--repeats", "0"], "--repeats must be at least 1, found 0"),
    ],
)
def test_wrong_input(arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*arguments)
    assert (code, out) == (ExitCode.BAD_INPUT, "")
    assert message in err
    assert list(Path().iterdir()) == []
