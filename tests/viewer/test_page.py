"""The page of `djpt view` in a browser."""

import base64
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import djpt
from djpt.apps.viewer.server import Server
from djpt.apps.viewer.session import Session
from djpt.scenes.overrides import described
from tests.kit.browser import CHROMIUM, Page, browsing

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")

SCENE = """
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/>
            <rfilter type="box"/></film>
    </sensor>
    <shape type="sphere" id="ball">
        <bsdf type="diffuse"><rgb name="reflectance" value="0.8, 0.2, 0.1"/></bsdf>
    </shape>
    <emitter type="constant" id="sky"><rgb name="radiance" value="0.5, 0.6, 1.5"/></emitter>
</scene>
"""

CTRL = 2
"""The modifier of the DevTools protocol."""


@dataclass
class Viewed:
    """A page, the server that it came from, the session that it shows, and the file of its scene."""

    page: Page
    server: Server
    session: Session
    file: Path

    def until(self, script: str) -> None:
        """Let the session work until an expression is true on the page."""
        for _ in range(3000):
            self.session.turn(self.server.inbox, patience=0.01)
            if self.page.run(script):
                return
        raise AssertionError((script, self.page.run("document.body.innerText"), self.page.errors))

    def until_done(self) -> None:
        self.until("Number(document.body.dataset.spp) >= 16")

    def ask(self, action: str) -> None:
        """Run a script that sends one message, and wait for a picture that answers it."""
        self.until_done()
        before = int(self.page.run("document.body.dataset.answer"))
        self.page.run(f"void ({action})")
        self.until(f"Number(document.body.dataset.answer) > {before}")
        self.until_done()

    def shown(self) -> np.ndarray:
        """The pixels of the page's canvas, as numbers of 8 bits."""
        data = self.page.run("picture.toDataURL('image/png').split(',')[1]")
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"), np.float64)


@pytest.fixture(scope="module")
def viewed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewed]:
    folder = tmp_path_factory.mktemp("view")
    file = folder / "scene.xml"
    file.write_text(SCENE)
    with Server() as server, browsing(folder / "profile") as page:
        session = Session(lambda: described(str(file))[1], 0, 16, 0, server.publish, server.publish)
        page.open(server.url)
        result = Viewed(page, server, session, file)
        result.until_done()
        yield result
        assert not page.errors
        assert {url.partition("/")[0] for url in page.requests} <= {"http:", "ws:", "data:"}
        assert all("127.0.0.1" in url for url in page.requests if not url.startswith("data:"))


@pytest.mark.parametrize("curve", ["srgb", "reinhard", "aces", "agx"])
def test_tone_curves_are_those_of_tonemap(viewed: Viewed, curve: str, tmp_path: Path) -> None:
    viewed.until_done()
    viewed.page.run(f"void (curve.value = '{curve}', exposure.value = 1, curve.onchange())")
    expected = djpt.Image(
        djpt.tonemap(np.ascontiguousarray(viewed.session.picture.image().numpy()), curve, exposure=1.0)
    )
    djpt.write(tmp_path / "expected.png", expected)
    encoded = np.asarray(Image.open(tmp_path / "expected.png").convert("RGB"), np.float64)
    shown = viewed.shown()
    viewed.page.run("void (curve.value = 'srgb', exposure.value = 0, curve.onchange())")
    assert np.abs(shown - encoded).max() <= 2


def test_the_pixel_under_the_pointer_has_its_value(viewed: Viewed) -> None:
    viewed.until_done()
    box = viewed.page.run("(({left, top, width}) => [left, top, width])(picture.getBoundingClientRect())")
    scale = box[2] / 48
    viewed.page.mouse("mouseMoved", box[0] + 20.5 * scale, box[1] + 15.5 * scale)
    text = viewed.page.run("document.getElementById('pixel').textContent")
    place, _, numbers = text.partition(":")
    assert place == "(20, 15)"
    assert np.allclose([float(x) for x in numbers.split()], viewed.session.picture.image().numpy()[15, 20], rtol=0.01)


def test_a_drag_turns_the_camera_and_a_button_brings_it_back(viewed: Viewed) -> None:
    session, home = viewed.session, viewed.session.stage.home.to_world
    viewed.until_done()
    left, top, width, height = viewed.page.run(
        "(({left, top, width, height}) => [left, top, width, height])(picture.getBoundingClientRect())"
    )
    middle = left + width / 2, top + height / 2
    before = int(viewed.page.run("document.body.dataset.answer"))
    viewed.page.drag(middle, (middle[0] + width / 8, middle[1]))
    viewed.until(f"Number(document.body.dataset.answer) > {before}")
    turned = session.stage.camera.to_world
    # What is seen follows the pointer to the right: the camera moves to the left, by an eighth of half a turn.
    assert np.allclose(turned[:3, 2], [np.sin(np.pi / 8), 0, -np.cos(np.pi / 8)], atol=1e-2)
    assert turned[0, 3] < 0
    viewed.ask("home.onclick()")
    assert np.array_equal(session.stage.camera.to_world, home)


def test_controls_change_parameters(viewed: Viewed) -> None:
    viewed.ask(
        "(() => { const picker = document.querySelector('label[data-key=\"ball.bsdf.reflectance.value\"] input');"
        " picker.value = '#00ff00'; picker.oninput(); })()"
    )
    assert np.allclose(viewed.session.stage.params["ball.bsdf.reflectance.value"], [[0], [1], [0]], atol=1e-6)
    red, green, _ = viewed.session.picture.image().numpy()[16, 24]
    assert green > 0.3 and red < 0.01


def test_a_wrong_value_is_told(viewed: Viewed) -> None:
    viewed.until_done()
    viewed.page.run(
        "(() => { const field = document.querySelectorAll('label[data-key=\"sensor.x_fov\"] input')[1];"
        " field.value = '999'; field.onchange(); })()"
    )
    viewed.until("!problem.hidden")
    assert "fov" in viewed.page.run("problem.textContent")


def test_layers(viewed: Viewed) -> None:
    for layer in ("albedo", "normal", "depth", "position", "uv", "shape", "error"):
        viewed.ask(f"(layer.value = '{layer}', layer.onchange())")
        assert viewed.page.run("document.body.dataset.layer") == layer
        assert viewed.shown().max() > 100, layer
    viewed.ask("(layer.value = 'light', layer.onchange())")


def test_a_window_of_pixels(viewed: Viewed) -> None:
    viewed.until_done()
    left, top, width, height = viewed.page.run(
        "(({left, top, width, height}) => [left, top, width, height])(picture.getBoundingClientRect())"
    )
    before = int(viewed.page.run("document.body.dataset.answer"))
    corner = left + 8.5 / 48 * width, top + 4.5 / 32 * height
    viewed.page.drag(corner, (left + 24.5 / 48 * width, top + 16.5 / 32 * height), CTRL)
    viewed.until(f"Number(document.body.dataset.answer) > {before}")
    assert viewed.session.stage.window == (8, 4, 16, 12)
    assert viewed.session.picture.image().numpy().shape == (12, 16, 3)
    assert viewed.shown().shape == (32, 48, 3)
    viewed.ask("whole.onclick()")
    assert viewed.session.stage.window == (0, 0, 48, 32)


def test_a_file_that_changes_is_loaded_again(viewed: Viewed) -> None:
    viewed.until_done()
    viewed.file.write_text(SCENE.replace("0.8, 0.2, 0.1", "0.1, 0.2, 0.8") + "\n")
    expected = "document.querySelector('label[data-key=\"ball.bsdf.reflectance.value\"] input').value"
    viewed.until(f"{expected} == '#597ce7'")
    viewed.file.write_text("<scene")
    viewed.until("!problem.hidden")
    assert "scene.xml" in viewed.page.run("problem.textContent")
    viewed.file.write_text(SCENE)
    viewed.until(f"{expected} != '#597ce7'")
    assert viewed.page.run("problem.hidden")
    viewed.until_done()


def test_pausing(viewed: Viewed) -> None:
    viewed.until_done()
    viewed.page.run("void pause.onclick()")
    viewed.until("pause.textContent == 'continue'")
    viewed.page.run("void home.onclick()")
    for _ in range(5):
        viewed.session.turn(viewed.server.inbox)
    assert viewed.session.picture.spp == 0
    viewed.page.run("void pause.onclick()")
    viewed.until_done()
