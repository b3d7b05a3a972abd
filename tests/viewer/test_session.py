"""Sessions: rounds that add up, and messages that change what is rendered."""

import json
import queue
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.description.overrides import described, override
from djpt.errors import DjptError
from djpt.long_renders.rounds import Rounds, round_seed
from djpt.rendering.arguments import find_integrator
from djpt.viewer.controls import controls
from djpt.viewer.picture import Picture
from djpt.viewer.session import Session, packed
from djpt.viewer.stage import Stage


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
    assert np.allclose(pages.pixels, shown.picture.pixels(), rtol=1e-3, atol=1e-4)


def test_rounds_of_any_size_give_the_error_of_the_mean() -> None:
    """The estimated error is that between pictures, though rounds have 1 to 4 samples."""
    scene = djpt.load_dict(box(rfilter="box"))
    sensor, integrator = scene.sensors()[0], find_integrator(scene, None)
    means, estimates = [], []
    for run in range(24):
        picture = Picture(("R", "G", "B"))
        for number, spp in enumerate((1, 2, 4, 1)):
            seed = round_seed(100 * run, number)
            picture.add(Rounds(scene, sensor, integrator, spp, "auto").begin(seed, None, None)(), spp)
        means.append(picture.pixels() @ np.array([0.212671, 0.715160, 0.072169]))
        estimates.append(picture.error() ** 2)
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


@pytest.mark.parametrize(
    "message",
    [
        {"do": "explode"},
        {},
        {"do": "set", "key": "no.such.key", "value": [1]},
        {"do": "set", "key": "white.reflectance.value", "value": "red"},
        {"do": "set", "key": "white.reflectance.value", "value": [float("nan")] * 3},
        {"do": "set", "key": ["white"], "value": [1]},
        {"do": "turn", "yaw": "much"},
        {"do": "turn", "yaw": 1e400, "pitch": 0},
        {"do": "crop", "x": 1},
        {"do": "crop", "x": 1e300, "y": 0, "width": 1, "height": 1},
        {"do": "show", "layer": "colour"},
        {"do": "show", "layer": []},
        {"do": ["show"]},
        {"do": "approach", "factor": float("nan")},
    ],
)
def test_what_cant_be_done_is_told(message: dict[str, Any]) -> None:
    pages = Pages()
    shown = session(pages)
    shown.take(message)
    shown.render_round()
    assert np.isfinite(pages.pixels).all()
    assert (pages.messages and pages.messages[-1]["error"]) or message.get("do") == "crop"


def test_light_and_error_share_their_rounds() -> None:
    pages = Pages()
    shown = session(pages)
    for _ in range(3):
        shown.render_round()
    spp = shown.picture.spp
    shown.take({"do": "show", "layer": "error"})
    assert shown.picture.spp == spp
    assert np.allclose(pages.pixels[..., 0], shown.picture.error(), rtol=1e-3, atol=1e-4)
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
