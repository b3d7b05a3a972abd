"""Sessions: rounds that add up, and messages that change what is rendered."""

import json
import queue
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.apps.viewer.controls import controls
from djpt.apps.viewer.session import Session, Stage, packed
from djpt.errors import DjptError
from djpt.rendering.progressive.accumulation import EvenAccumulation
from djpt.rendering.progressive.rounds import Rounds, round_seed
from djpt.rendering.settings import RenderSettings
from djpt.scenes.overrides import described, override


class Pages:
    """What pages would get."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.messages: list[dict[str, Any]] = []

    @property
    def header(self) -> dict[str, Any]:
        length = int.from_bytes(self.frames[-1][:4], "little")
        return json.loads(self.frames[-1][4 : 4 + length])

    @property
    def pixels(self) -> np.ndarray:
        """The newest frame, as the page reads it."""
        length = int.from_bytes(self.frames[-1][:4], "little")
        _, _, width, height = self.header["window"]
        return np.frombuffer(self.frames[-1], "<f2", offset=4 + length).reshape(height, width, 3).astype(np.float32)


def box(**options: Any) -> dict[str, Any]:
    return override(described("cornell_box")[1], width=24, **options)


def session(pages: Pages, spp: int = 8, **options: Any) -> Session:
    return Session(lambda: box(**options), 0, spp, 3, pages.frames.append, pages.messages.append)


def test_a_picture_is_the_sum_of_its_rounds() -> None:
    pages = Pages()
    shown = session(pages)
    while not shown.waits:
        shown.render_round()
    assert pages.header["spp"] == 8 == shown.picture.spp
    assert np.allclose(pages.pixels, shown.picture.image().numpy(), rtol=1e-3, atol=1e-4)


def test_rounds_of_any_size_give_the_error_of_the_mean() -> None:
    """The estimated error is that between pictures, though rounds have 1 to 4 samples."""
    scene = djpt.load_dict(box(rfilter="box"))
    means, estimates = [], []
    for run in range(24):
        picture = EvenAccumulation.empty({}, ("R", "G", "B"), 0, (24, 24), 1, "auto")
        for number, spp in enumerate((1, 2, 4, 1)):
            seed = round_seed(100 * run, number)
            picture = picture.with_round(seed, spp, Rounds(scene, RenderSettings.of(scene, spp=spp)).begin(seed)())
        means.append(picture.image().numpy() @ np.array([0.212671, 0.715160, 0.072169]))
        estimates.append(picture.error().pixels.numpy() ** 2)
    assert np.isclose(np.mean(estimates), np.var(means, axis=0, ddof=1).mean(), rtol=0.15)


def test_messages_begin_the_picture_anew() -> None:
    pages = Pages()
    shown = session(pages)
    inbox: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    shown.turn(inbox)
    inbox.put({"do": "join"})
    inbox.put({"do": "set", "key": "white.reflectance.value", "value": [0, 0, 0], "number": 7})
    shown.turn(inbox)
    state = pages.messages[0]
    assert {c["key"] for c in state["controls"]} > {"white.reflectance.value", "sensor.x_fov"}
    assert pages.header["answer"] == 7
    assert shown.picture.rounds == 1
    inbox.put({"do": "crop", "x": 2, "y": 3, "width": 5, "height": 400, "number": 8})
    shown.turn(inbox)
    assert pages.header["window"] == [2, 3, 5, 21]
    assert pages.pixels.shape == (21, 5, 3)


FIELDS: dict[str, dict[str, Any]] = {
    "turn": {"yaw": 0.1, "pitch": 0.1},
    "shift": {"right": 0.1, "up": 0.1},
    "approach": {"factor": 0.9},
    "home": {},
    "crop": {"x": 0, "y": 0, "width": 5, "height": 5},
    "set": {"key": "white.reflectance.value", "value": [0.5, 0.5, 0.5]},
    "show": {"layer": "depth"},
    "pause": {"paused": False},
    "join": {},
}
"""What pages ask for, with the fields of each message."""

DEEP: list[Any] = []
for _ in range(20000):
    DEEP = [DEEP]

STRANGE: list[Any] = [
    *(None, True, "", "much", "nan", "x" * 60000, "\x1b[2J", [], {}, {"a": 1}, DEEP, -1, 2**63, 1e308, 1e-320),
    *(float("inf"), float("-inf"), float("nan"), 10**400, -(10**400), 10**5000),
    *([value] * 3 for value in (None, True, "red", float("inf"), float("nan"), 1e300, 10**400, 10**5000, [1])),
    *([10**400], [1e300], [DEEP], [True], [0.5] * 2, [0.5] * 100),
]
"""What may stand in any field: JSON has integers of any length, NaN and Infinity too."""


@pytest.fixture(scope="module")
def attacked() -> tuple[Session, Pages]:
    pages = Pages()
    return session(pages), pages


@pytest.mark.sparse(12)
@pytest.mark.parametrize("do", FIELDS)
def test_no_message_ends_the_viewer(do: str, attacked: tuple[Session, Pages]) -> None:
    """Messages with anything in any field, or without a field: they are refused, or lead to a picture of numbers."""
    shown, pages = attacked
    inbox: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    sound = {"do": do, **FIELDS[do], "number": 1}
    messages = [{key: value for key, value in sound.items() if key != left_out} for left_out in sound]
    messages += [{**sound, name: value} for name in sound for value in STRANGE]
    for message in messages:
        inbox.put(message)
        shown.turn(inbox, 0.0)
        for told in pages.messages:
            json.dumps(told)
            assert len(told.get("error", "")) < 1000
        pages.messages.clear()
    assert np.isfinite(pages.pixels).all()
    for message in ({"do": "pause"}, {"do": "show", "layer": "light"}, {"do": "home", "number": 99}):
        inbox.put(message)
    shown.turn(inbox)
    assert not shown.waits
    assert pages.header["answer"] == 99
    assert np.isfinite(pages.pixels).all()


@pytest.mark.parametrize(
    ("do", "field", "value"),
    [
        *(("turn", "yaw", value) for value in (10**400, float("inf"), "0.1", True, None, DEEP)),
        *(("approach", "factor", value) for value in (10**400, float("nan"), [])),
        *(("crop", "x", value) for value in (float("inf"), 1e300, "1")),
        *(("set", "value", value) for value in ([10**400] * 3, [float("inf")] * 3, [True], "red", DEEP)),
        *(("set", "key", value) for value in ("no.such.key", ["white"], DEEP, "x" * 60000)),
        *(("show", "layer", value) for value in ("colour", [], DEEP)),
        *((do, "do", "explode") for do in ("turn",)),
    ],
)
def test_what_cant_be_done_is_told(do: str, field: str, value: Any, attacked: tuple[Session, Pages]) -> None:
    shown, pages = attacked
    pages.messages.clear()
    shown.take({"do": do, **FIELDS[do], field: value})
    (told,) = pages.messages
    assert 0 < len(told["error"]) < 1000


def test_a_camera_cant_leave_the_numbers(attacked: tuple[Session, Pages]) -> None:
    shown, pages = attacked
    pages.messages.clear()
    for factor in [0.25] * 600 + [4.0] * 1200:
        shown.take({"do": "approach", "factor": factor})
    assert np.isfinite(shown.stage.camera.to_world).all()
    assert any("camera" in told["error"] for told in pages.messages)
    shown.take({"do": "home"})
    shown.render_round()
    assert np.isfinite(pages.pixels).all()


def test_a_round_that_fails_after_a_message_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values may lead anywhere; but a scene that nobody has touched and that can't be rendered ends the command."""

    def fail(self: Rounds, *arguments: Any) -> Any:
        raise RuntimeError("no such round")

    pages = Pages()
    shown = session(pages)
    inbox: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    begin = Rounds.begin
    monkeypatch.setattr(Rounds, "begin", fail)
    with pytest.raises(RuntimeError, match="no such round"):
        shown.turn(inbox)
    inbox.put({"do": "home"})
    shown.turn(inbox)
    assert pages.messages == [{"error": "no such round"}]
    assert shown.waits
    assert shown.state()["problem"] == "no such round"
    monkeypatch.setattr(Rounds, "begin", begin)
    inbox.put({"do": "home"})
    shown.turn(inbox)
    assert shown.picture.spp and not shown.state()["problem"]


@pytest.mark.sparse(4)
@pytest.mark.parametrize("integrator", ["guided", "bdpt", "sppm", "mmlt", "ptracer", "volpath", "direct"])
def test_integrators_are_shown(integrator: str) -> None:
    """Rounds after the first two are launched again without Python, where that is possible."""
    pages = Pages()
    shown = session(pages, spp=4, integrator=integrator)
    shown._round_spp = 1
    for _ in range(4):
        shown.render_round()
        shown._round_spp = 1
    assert np.isfinite(pages.pixels).all() and pages.pixels.mean() > 0


SCENE = """<scene version="3.0.0">
    <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/>
    </film></sensor>
    <shape type="sphere"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="paint.png"/></texture></bsdf></shape>
    <emitter type="constant"/>{more}
</scene>"""


def looked(shown: Session) -> None:
    """Let a session look at its files, as it does from time to time."""
    shown._looked = float("-inf")
    shown.turn(queue.SimpleQueue(), 0.0)


def test_a_repaired_scene_clears_its_error(tmp_path: Path) -> None:
    file, pages = tmp_path / "scene.xml", Pages()
    paint = np.full((2, 2, 3), 0.5, np.float32)
    djpt.write(tmp_path / "paint.png", paint)
    file.write_text(SCENE.format(more=""))
    shown = Session(lambda: described(str(file))[1], 0, 4, 0, pages.frames.append, pages.messages.append)
    file.write_text("<scene")
    looked(shown)
    assert "scene.xml" in pages.messages[-1]["error"]
    # Who comes now learns it as well.
    shown.take({"do": "join"})
    assert "scene.xml" in pages.messages[-1]["problem"]
    file.write_text(SCENE.format(more="<!-- mended -->"))
    looked(shown)
    assert pages.messages[-1]["problem"] == ""


def test_a_scene_is_mended_by_a_file_that_appears(tmp_path: Path) -> None:
    """Nobody knew of the file while it was missing."""
    file, pages = tmp_path / "scene.xml", Pages()
    djpt.write(tmp_path / "paint.png", np.full((2, 2, 3), 0.5, np.float32))
    file.write_text(SCENE.format(more=""))
    shown = Session(lambda: described(str(file))[1], 0, 4, 0, pages.frames.append, pages.messages.append)
    file.write_text(SCENE.format(more='<include filename="other.xml"/>'))
    looked(shown)
    assert "other.xml" in pages.messages[-1]["error"]
    told = len(pages.messages)
    (tmp_path / "other.xml").write_text('<scene version="3.0.0"><emitter type="point"/></scene>')
    deadline = time.monotonic() + 30
    while shown.state()["problem"] != "":
        assert time.monotonic() < deadline
        looked(shown)
        time.sleep(0.1)
    assert [message.get("problem") for message in pages.messages[told:]] == [""]


def test_light_and_error_share_their_rounds() -> None:
    pages = Pages()
    shown = session(pages)
    for _ in range(3):
        shown.render_round()
    spp = shown.picture.spp
    shown.take({"do": "show", "layer": "error"})
    assert shown.picture.spp == spp
    assert np.allclose(pages.pixels[..., 0], shown.picture.error().pixels, rtol=1e-3, atol=1e-4)
    shown.take({"do": "show", "layer": "depth"})
    assert shown.picture.spp == 0
    shown.render_round()
    depth = pages.pixels
    assert np.array_equal(depth[..., 0], depth[..., 2])


def test_a_sensor_that_takes_no_pictures() -> None:
    scene = {"type": "scene", "ball": {"type": "sphere", "meter": {"type": "irradiancemeter"}}}
    with pytest.raises(DjptError, match="takes no pictures"):
        Stage(scene)


def test_controls_have_useful_ranges() -> None:
    scene = djpt.load_dict(
        {
            "type": "scene",
            "ball": {"type": "sphere", "bsdf": {"type": "principled", "roughness": 0.3}},
            "lamp": {"type": "point", "position": [1.0, 2.0, 3.0], "intensity": 7.0},
        }
    )
    found = {control["key"]: control for control in controls(djpt.traverse(scene))}
    assert found["ball.bsdf.roughness.value"]["high"] == 1
    assert found["lamp.position"]["kind"] == "point"
    assert all(c["low"] <= c["value"][0] <= c["high"] for c in found.values() if c["kind"] == "number")
    assert not any("vertex" in key or "to_world" in key for key in found)


def test_huge_light_stays_a_number() -> None:
    frame = packed({}, np.array([[[1e9, -1e9, 0.5]]], np.float32))
    assert np.array_equal(np.frombuffer(frame, "<f2", offset=6), np.array([65504, -65504, 0.5], np.float16))
