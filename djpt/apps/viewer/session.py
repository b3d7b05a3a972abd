"""A render that restarts whenever the view changes."""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import djpt
from djpt.apps.orbit import OrbitCamera
from djpt.apps.viewer.controls import changed, controls, in_one_line, number, whole_number
from djpt.core.transforms import ScalarTransform4f
from djpt.description.files import files_of
from djpt.errors import RenderError, near_miss
from djpt.images.tone_mapping import ACES_IN, ACES_OUT, AGX_CURVE, AGX_IN, AGX_OUT, AGX_STOPS
from djpt.integrators.base import Integrator
from djpt.rendering.image import channel_names
from djpt.rendering.progressive.accumulation import EvenAccumulation
from djpt.rendering.progressive.rounds import Rounds, round_seed
from djpt.rendering.settings import RenderSettings, find_integrator
from djpt.scene.scene import find_sensor
from djpt.sensors.orthographic import Orthographic
from djpt.sensors.projective import ProjectiveCamera

__all__ = ["Session", "Stage", "Watch", "packed"]

LAYERS = {
    "light": "",
    "error": "",
    "albedo": "albedo",
    "normal": "sh_normal",
    "depth": "depth",
    "position": "position",
    "uv": "uv",
    "shape": "shape_index",
}
"""The layers that can be shown: the image, its error, and variables of the integrator `aov`."""


class Stage:
    """A loaded scene with a camera that moves, a window of pixels, and a layer.

    Args:
        description: the scene's dict.
        sensor: the number of the camera.

    Raises:
        RenderError: The sensor takes no pictures, or there is no sensor with this number.
    """

    def __init__(self, description: Mapping[str, Any], sensor: int = 0) -> None:
        self.scene = djpt.load_dict(dict(description) if type(description) is dict else description)
        self.params = djpt.traverse(self.scene)
        self.sensor = find_sensor(self.scene, sensor)
        if not isinstance(self.sensor, ProjectiveCamera):
            raise RenderError(f"'{self.sensor.id()}' takes no pictures: choose a camera with --sensor")
        self.number = sensor
        self.layer = "light"
        self._aovs: dict[str, Integrator] = {}
        names = self.params.names_of(self.sensor)
        self._to_world = next(name for name in names if name.endswith("to_world"))
        film = self.params.names_of(self.sensor.film())
        self._crop = {name.rpartition(".")[2]: name for name in film}
        self.camera = self.home = OrbitCamera.of(self.scene, self.sensor)
        """The camera's current placement, and its placement in the scene."""

    # ---- what is rendered --------------------------------------------------------------------

    @property
    def integrator(self) -> Integrator:
        """The integrator of the layer that is shown."""
        variable = LAYERS[self.layer]
        if not variable:
            return find_integrator(self.scene, None)
        if variable not in self._aovs:
            self._aovs[variable] = djpt.load_dict({"type": "aov", "aovs": f"x:{variable}"})
        return self._aovs[variable]

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the image's channels."""
        return channel_names(self.scene, self.number, self.integrator)

    def begun(self) -> EvenAccumulation:
        """The sum of no rounds of the image; each round will count by its samples per pixel."""
        unfiltered = len(self.integrator.unfiltered_names())
        return EvenAccumulation.empty({}, self.channels, unfiltered, self.window[2:], 1, "auto")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the film in pixels."""
        width, height = self.sensor.film().size()
        return int(width), int(height)

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Column and row of the first pixel that is rendered, and the number of columns and rows."""
        (x, y), (width, height) = self.sensor.film().crop_offset(), self.sensor.film().crop_size()
        return int(x), int(y), int(width), int(height)

    # ---- what changes it ---------------------------------------------------------------------

    def show(self, layer: Any) -> None:
        """Show another layer."""
        if not isinstance(layer, str) or layer not in LAYERS:
            name = str(layer)[:40]
            raise RenderError(f"unknown layer '{name}'{near_miss(name, LAYERS)}")
        self.layer = layer

    def crop(self, x: int, y: int, width: int, height: int) -> None:
        """Render only a window, clipped to the film; the whole film if the window is empty."""
        columns, rows = self.size
        left, top = min(max(x, 0), columns), min(max(y, 0), rows)
        right, bottom = min(max(x + width, 0), columns), min(max(y + height, 0), rows)
        if right <= left or bottom <= top:
            left, top, right, bottom = 0, 0, columns, rows
        # Both at once: neither need fit with the other's old value.
        self.params.update(
            {self._crop["crop_offset"]: (left, top), self._crop["crop_size"]: (right - left, bottom - top)}
        )

    def turn(self, yaw: float, pitch: float) -> None:
        """Orbit the camera about its target, by angles in radians."""
        self.hold(self.camera.turned(yaw, pitch))

    def shift(self, right: float, upward: float) -> None:
        """Move the camera sideways, by multiples of its distance."""
        self.hold(self.camera.shifted(right * self.camera.distance, upward * self.camera.distance))

    def approach(self, factor: float) -> None:
        """Multiply the distance, or without perspective the size of what is seen, by a factor from 1/4 to 4."""
        factor = min(max(factor, 0.25), 4.0)
        orthographic = isinstance(self.sensor, Orthographic)
        self.hold(self.camera.scaled(factor) if orthographic else self.camera.approached(factor))

    def hold(self, camera: OrbitCamera) -> None:
        """Put the camera somewhere.

        Raises:
            RenderError: The camera is so far away, or so near to its target, that its position isn't finite.
        """
        if not (np.isfinite(camera.to_world).all() and np.isfinite(camera.distance) and camera.distance > 0):
            raise RenderError("the camera can't move there: its position would no longer be finite")
        self.params.update({self._to_world: ScalarTransform4f(camera.to_world)})
        self.camera = camera


# ---- the session -----------------------------------------------------------------------------


SHORT, LONG = 0.02, 0.06
"""Seconds of a round's kernel below which the next round has more samples, and above which it has fewer.

Messages of the page are handled between rounds, and each round has an overhead besides its kernel.
"""

FRAME_SECONDS = 0.25
"""The time between two frames of a picture that is being refined; the first ones are sent at once.

Browsers take time to show a frame, which rounds that run meanwhile take from them.
"""

LOOK_SECONDS = 0.5
"""The time between two checks of the scene's files."""

RETRY_SECONDS = 2.0
"""The time after which a scene that couldn't be loaded is tried again, though no known file of it has changed."""

RETRY_SHARE = 10
"""The minimum ratio of the time to the next attempt to the duration of the last one."""

MESSAGES = 1000
"""The maximum number of messages handled between two rounds."""

LARGEST_HALF = float(np.finfo(np.float16).max)

TONE = {
    "aces_in": ACES_IN.tolist(),
    "aces_out": ACES_OUT.tolist(),
    "agx_in": AGX_IN.tolist(),
    "agx_out": AGX_OUT.tolist(),
    "agx_curve": list(AGX_CURVE),
    "agx_stops": list(AGX_STOPS),
}
"""The constants of the tone curves, for the page that computes them."""


Inbox: TypeAlias = "queue.SimpleQueue[dict[str, Any]] | queue.Queue[dict[str, Any]]"
"""The messages of pages, in their order."""


class Session:
    """The session behind a page: a scene, rendered in rounds, until `spp` samples per pixel.

    Args:
        describe: reads the scene; called again when one of its files changes.
        sensor: the number of the camera.
        spp: samples per pixel of a finished picture.
        seed: of the picture.
        publish: called with a frame for the pages: see `packed`.
        tell: called with a message for the pages.

    Raises:
        DjptError: The scene can't be loaded or rendered.
    """

    def __init__(
        self,
        describe: Callable[[], Mapping[str, Any]],
        sensor: int,
        spp: int,
        seed: int,
        publish: Callable[[bytes], None],
        tell: Callable[[dict[str, Any]], None],
    ) -> None:
        self._describe, self._sensor = describe, sensor
        self.spp, self.seed = spp, seed
        self._publish, self._tell = publish, tell
        description = describe()
        self._watch = Watch(files_of(description))
        self.stage = Stage(description, sensor)
        self.picture = self.stage.begun()
        """The sum of all rounds."""
        self._round_spp, self._paused, self._asked = 1, False, 0
        self._touched = False
        """True if the scene has been changed since it was first loaded."""
        self._problem, self._retry = "", 0.0
        """The reason why the scene's files can no longer be loaded, and when to try again."""
        self._failure = ""
        """The reason why the scene can't be rendered as it is."""
        self._rounds: Rounds | None = None
        self._start = self._looked = self._published = time.perf_counter()

    def run(self, inbox: Inbox) -> None:
        """Render and handle messages until an exception ends the loop, such as `KeyboardInterrupt`."""
        while True:
            self.turn(inbox)

    def turn(self, inbox: Inbox, patience: float = LOOK_SECONDS) -> None:
        """Handle pending messages, check the scene's files if it is time, and render a round.

        If there is nothing to render, wait for a message, for `patience` seconds at most.

        Raises:
            DjptError: The scene can't be rendered, although it hasn't been changed.
        """
        # All that has come is taken before a round: a pointer that moves asks for more than can be rendered.
        waiting = self.waits
        for _ in range(MESSAGES):
            try:
                # In Python 3.10 a `SimpleQueue` that is to block for 0 seconds may do so for ever.
                self.take(inbox.get(waiting and patience > 0, patience))
                waiting = False
            except queue.Empty:
                break
        if time.perf_counter() - self._looked > LOOK_SECONDS:
            self.reload_if_changed()
            self._looked = time.perf_counter()
        if self.waits:
            return
        try:
            self.render_round()
        except Exception as error:  # whatever the values that pages choose lead to
            if not self._touched:
                raise
            self._failure = in_one_line(error)
            self._tell({"error": self._failure})

    # ---- rounds ------------------------------------------------------------------------------

    @property
    def waits(self) -> bool:
        """True if there is nothing to render until something changes."""
        return self._paused or bool(self._failure) or self.picture.spp >= self.spp

    def render_round(self) -> None:
        """Add a round to the picture, and publish it."""
        stage = self.stage
        spp = stage.sensor.sampler().round_count(min(self._round_spp, max(1, self.spp - self.picture.spp)))
        seed = round_seed(self.seed, self.picture.rounds)
        if self._rounds is None or self._rounds.spp != spp:
            self._rounds = Rounds(stage.scene, RenderSettings(stage.sensor, stage.integrator, spp=spp))
        result = self._rounds.begin(seed)
        start = time.perf_counter()
        part = result()
        seconds = time.perf_counter() - start
        self.picture = self.picture.with_round(seed, spp, part)
        if self.picture.rounds > 1 and seconds < SHORT:
            self._round_spp = 2 * spp
        elif seconds > LONG:
            self._round_spp = max(1, spp // 2)
        if self.picture.rounds <= 2 or self.waits or time.perf_counter() - self._published >= FRAME_SECONDS:
            self.publish()

    def publish(self) -> None:
        """Publish the picture as it is."""
        self._published = time.perf_counter()
        if self.picture.rounds:
            self._publish(packed(self.header(), self.shown()))

    def shown(self) -> npt.NDArray[np.float32]:
        """The three channels of the layer that is shown, (height, width, 3)."""
        if self.stage.layer == "error":  # infinite after one round
            pixels = np.nan_to_num(self.picture.error().pixels.numpy(), posinf=0.0)[..., None]
        else:
            pixels = self.picture.image().numpy()
        if self.stage.layer == "uv":
            return np.pad(pixels, ((0, 0), (0, 0), (0, 1)))
        return pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)

    def header(self) -> dict[str, Any]:
        """The header of a frame."""
        x, y, width, height = self.stage.window
        error = self.picture.error().overall
        return {
            "size": self.stage.size,
            "window": [x, y, width, height],
            "layer": self.stage.layer,
            "spp": self.picture.spp,
            "goal": self.spp,
            "error": error if math.isfinite(error) else 0.0,
            "seconds": time.perf_counter() - self._start,
            "answer": self._asked,
        }

    # ---- messages ----------------------------------------------------------------------------

    def take(self, message: Mapping[str, Any]) -> None:
        """Carry out a page's request; failures are reported to the pages as errors."""
        do = message.get("do")
        try:
            if do == "join":
                self._tell(self.state())
                self.publish()
            elif do == "pause":
                self._paused = bool(message.get("paused"))
            elif isinstance(do, str) and do in CHANGES:
                variable = LAYERS[self.stage.layer]
                self._touched = True
                CHANGES[do](self.stage, message)
                asked = message.get("number")
                self._asked = asked if type(asked) is int and 0 <= asked < 2**53 else 0
                if do == "show" and LAYERS[self.stage.layer] == variable:
                    self.publish()  # light and its error are of the same rounds
                else:
                    self.begin()
            else:
                raise RenderError(f"unknown message '{str(do)[:40]}'")
        except Exception as error:  # whatever a message leads to, it mustn't end the viewer of all pages
            self._tell({"error": in_one_line(error)})

    def begin(self) -> None:
        """Restart the picture, with rounds of one sample per pixel."""
        self.picture, self._round_spp, self._rounds = self.stage.begun(), 1, None
        self._failure = ""
        self._start = time.perf_counter()

    def reload_if_changed(self) -> None:
        """Reload the scene if one of its files has changed; errors are reported, and the old scene stays.

        If loading fails it is retried from time to time: the fix may be in a file that isn't known yet.
        """
        start = time.perf_counter()
        changed = self._watch.has_changed()
        if not changed and not (self._problem and start >= self._retry):
            return
        try:
            description = self._describe()
            fresh = Stage(description, self._sensor)
            fresh.show(self.stage.layer)
            if not np.array_equal(self.stage.camera.to_world, self.stage.home.to_world) and np.array_equal(
                fresh.home.to_world, self.stage.home.to_world
            ):
                fresh.hold(self.stage.camera)
        except Exception as error:  # whatever stands in a file that is being edited
            found, end = in_one_line(error), time.perf_counter()
            self._retry = end + max(RETRY_SECONDS, RETRY_SHARE * (end - start))
            if changed or found != self._problem:
                self._problem = found
                self._tell({"error": found})
            return
        self.stage, self._watch, self._problem = fresh, Watch(files_of(description)), ""
        self._touched = True
        self.begin()
        self._tell(self.state())

    def state(self) -> dict[str, Any]:
        """The state of the scene for a page."""
        return {
            "layers": list(LAYERS),
            "layer": self.stage.layer,
            "size": self.stage.size,
            "controls": controls(self.stage.params),
            "tone": TONE,
            "paused": self._paused,
            "problem": self._problem or self._failure,
        }


CHANGES: dict[str, Callable[[Stage, Mapping[str, Any]], None]] = {
    "turn": lambda stage, m: stage.turn(number(m, "yaw"), number(m, "pitch")),
    "shift": lambda stage, m: stage.shift(number(m, "right"), number(m, "up")),
    "approach": lambda stage, m: stage.approach(number(m, "factor")),
    "home": lambda stage, m: stage.hold(stage.home),
    "crop": lambda stage, m: stage.crop(*(whole_number(m, name) for name in ("x", "y", "width", "height"))),
    "set": lambda stage, m: changed(stage.params, m.get("key"), m.get("value")),
    "show": lambda stage, m: stage.show(m.get("layer")),
}
"""The messages that change the view, and the methods that handle them."""


def packed(header: Mapping[str, Any], pixels: npt.NDArray[np.float32]) -> bytes:
    """A frame as bytes: the length of the header (uint32), the header (JSON, padded to even length), then the pixels.

    Pixels are little-endian float16, row by row, red, green, blue; larger numbers become the largest one.
    """
    text = json.dumps(header).encode()
    text += b" " * (len(text) % 2)
    with np.errstate(over="ignore"):
        halves = np.clip(pixels, -LARGEST_HALF, LARGEST_HALF).astype("<f2")
    return len(text).to_bytes(4, "little") + text + halves.tobytes()


# ---- changes of the files that a scene was read from -----------------------------------------


class Watch:
    """Detects new versions of files by their size and modification time."""

    def __init__(self, files: Iterable[Path]) -> None:
        self.files = tuple(files)
        """The files that are watched."""
        self._seen: dict[Path, tuple[int, int]] = {}
        self.has_changed()

    def has_changed(self) -> bool:
        """True if a file has changed since the last call. A file that is missing momentarily hasn't."""
        found = {}
        for path in self.files:
            with contextlib.suppress(OSError):
                status = os.stat(path)
                found[path] = status.st_mtime_ns, status.st_size
        changed = any(self._seen.get(path) != stamp for path, stamp in found.items())
        self._seen |= found
        return changed
