"""Renders in rounds on the command line: their progress lines, and the files that they continue from."""

from __future__ import annotations

import contextlib
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from djpt.apps.cli.console import announce
from djpt.core.files import check_target, reason
from djpt.core.interruption import Interruption, interruptible
from djpt.core.terminal import beneath, visible
from djpt.errors import FileError, RenderError
from djpt.rendering.progress import has_terminal, short

if TYPE_CHECKING:
    from djpt.rendering.progressive.accumulation import Accumulation
    from djpt.rendering.settings import RenderSettings

__all__ = ["Passes", "passes_of", "seconds_of", "share_of", "status"]

PREVIEW_SECONDS = 1.0
"""The minimum time between two writings of the preview."""

CONNECTION_SECONDS = 6.0
"""The time that a scheduler has to answer."""

CLOSING_SECONDS = 2.0
"""The time that it has in the end."""

UNITS = {"s": 1, "m": 60, "h": 3600, "d": 86400}


@dataclass(frozen=True)
class Passes:
    """The options of a render in rounds."""

    checkpoint: Path | None
    """The checkpoint file."""
    every: float
    """The seconds between two writings of it."""
    resume: bool
    """True to continue from that file, if it exists."""
    target_error: float | None
    time_budget: float | None
    adaptive: bool = False
    """True to take more samples where there is more noise."""
    cluster: str | None = None
    """The address of a scheduler whose workers render."""
    preview: Path | None = None
    """A picture that is rewritten as rounds complete."""

    def check(self) -> None:
        """Raise an error if options contradict each other, or the checkpoint would be lost by a new render."""
        if self.resume and self.checkpoint is None:
            raise RenderError("--resume needs --checkpoint FILE, the file to continue from")
        if self.cluster is not None and not self.cluster.strip():
            raise RenderError("--cluster takes the address of a scheduler, such as tcp://host:8786; found ''")
        if self.cluster is not None and self.adaptive:
            raise RenderError("--adaptive plans each round from the previous ones, so --cluster can't distribute them")
        if self.preview is not None:
            from djpt.images.image import check_writable

            check_writable(self.preview)
        if self.checkpoint is None:
            return
        check_target(self.checkpoint)
        if self.checkpoint.exists() and not self.resume:
            raise FileError(f"'{self.checkpoint}' exists: continue from it (--resume), or remove it")

    def render(
        self,
        scene: Any,
        description: Mapping[str, Any],
        settings: RenderSettings,
        keep_partial: bool,
        quiet: bool,
    ) -> tuple[Accumulation, int, Callable[[], None]]:
        """The accumulation, its new samples per pixel, and a function to be called once the image is written.

        The function ends the process if a signal has come. A signal ends a render only after the checkpoint is written.
        """
        import djpt
        from djpt.apps.cli.pictures import Stored

        begun, spp = None, settings.spp
        if self.resume and self.checkpoint is not None and self.checkpoint.exists():
            begun = djpt.Accumulation.load(self.checkpoint)
        found, first = begun, 0 if begun is None else begun.whole.spp
        saved = begun
        start = last = shown = time.perf_counter()
        line = Line(quiet)

        def save() -> None:
            nonlocal saved, last
            if self.checkpoint is not None and found is not None and saved is not found:
                found.save(self.checkpoint)
                saved, last = found, time.perf_counter()

        def leave() -> None:
            if spp and found is not None:
                # A round that was left has added nothing.
                interruption.begin_part(found.spp / spp, 0)
            interruption.leave(
                f"'{self.checkpoint}' holds the partial image" if self.checkpoint else "the image is partial"
            )

        def show() -> None:
            nonlocal shown
            if self.preview is not None and found is not None:
                colours = len(settings.sensor.film().channel_names())
                Stored(self.preview, found.channels, colours).write(found.image())
                shown = time.perf_counter()

        options: dict[str, Any] = {
            "sensor": scene.sensors().index(settings.sensor),
            "seed": settings.seed,
            "spp": spp,
            "target_error": self.target_error,
            "time_budget": self.time_budget,
            "resume_from": begun,
            "schedule": settings.schedule,
        }
        with interruptible(keeps=False) as interruption, line, self.connected(interruption) as client:
            try:
                if client is None:
                    images = djpt.render_passes(scene, adaptive=self.adaptive, interruption=interruption, **options)
                else:
                    from djpt.apps.cluster.rendering import render_passes

                    images = at_once(interruption, render_passes(client, description, on_wait=line.announce, **options))
                for found in images:
                    if time.perf_counter() - shown >= PREVIEW_SECONDS:
                        show()
                    if line.visible:
                        done, elapsed = found.spp - first, time.perf_counter() - start
                        line.show(status(found, done, elapsed, spp, self.target_error, self.time_budget))
                    if time.perf_counter() - last >= self.every:
                        save()
                    if interruption.requested:
                        break
            except (KeyboardInterrupt, SystemExit):
                if interruption.signal is None or found is None:
                    raise
            save()
            show()
            if not keep_partial:
                leave()
        assert found is not None
        return found, 0 if found is begun else found.spp - first, leave

    @contextlib.contextmanager
    def connected(self, interruption: Interruption) -> Iterator[Any]:
        """A client of the cluster, or None if no cluster is used."""
        if self.cluster is None:
            yield None
            return
        from djpt.apps.cluster.rendering import within
        from djpt.apps.cluster.work import distributed

        connect = distributed().Client
        try:
            with interruption.waiting():
                client = within(CONNECTION_SECONDS, lambda: connect(self.cluster, timeout=CONNECTION_SECONDS))
        except Exception as error:  # also what the answer of a server of another kind leads to
            raise RenderError(f"no scheduler answers at '{self.cluster}': {unanswered(error)}") from None
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):  # the scheduler may have stopped
                client.close(timeout=CLOSING_SECONDS)


def at_once(interruption: Interruption, images: Iterator[Accumulation]) -> Iterator[Accumulation]:
    """Images that are rendered elsewhere: signals needn't wait for them."""
    try:
        while True:
            with interruption.waiting():
                found = next(images, None)
            if found is None:
                return
            yield found
    finally:
        images.close()  # type: ignore[attr-defined]


def unanswered(error: Exception) -> str:
    """The reason why there is no connection to a scheduler."""
    if isinstance(error, (OSError, ValueError, TypeError)) and not isinstance(error, UnicodeError):
        return reason(error)
    return "the server at this address isn't a scheduler"


def status(
    found: Accumulation, taken: int, elapsed: float, spp: int, target_error: float | None, time_budget: float | None
) -> str:
    """A progress line: samples and error so far, speed, time left, and the reason for which the render will stop.

    Args:
        found: The accumulation so far.
        taken: Its samples per pixel that were taken in `elapsed` seconds.
        elapsed: The time since the start.
        spp: The samples per pixel to stop at; 0: no limit.
        target_error: The relative RMSE to stop at.
        time_budget: The seconds to stop at.
    """
    error = found.error().overall
    width, height = found.size
    texts = [f"{found.spp} spp", f"error {error:.2%}" if math.isfinite(error) else "error unknown"]
    if taken and elapsed > 0:
        speed = taken / elapsed
        texts.append(f"{short(speed * width * height)}samples/s")
        ends = []
        if spp:
            ends.append(((spp - found.spp) / speed, f"{spp} spp"))
        if target_error is not None and math.isfinite(error):
            ends.append((found.spp * ((error / target_error) ** 2 - 1) / speed, f"an error of {target_error:.3g}"))
        if time_budget is not None:
            ends.append((time_budget - elapsed, f"{time_budget:.4g} s"))
        if ends:
            left, why = min(ends)
            texts.append(f"{max(0.0, left):.0f} s left until {why}")
    return ", ".join(texts)


class Line:
    """A terminal line that is rewritten repeatedly, and is erased at the end."""

    def __init__(self, quiet: bool) -> None:
        self.visible = not quiet and has_terminal()

    def show(self, text: str) -> None:
        """Replace the line, if there is a terminal."""
        if self.visible:
            print(f"\r\x1b[2K{visible(text)}", end="", file=beneath(sys.stderr), flush=True)

    def announce(self, text: str) -> None:
        """Print a line that stays, above the status line."""
        self.show("")
        announce(f"djpt: {text}")

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *error: object) -> None:
        self.show("")


# ---- options -----------------------------------------------------------------------------------


def passes_of(**options: Any) -> Passes | None:
    """The render in rounds that the options ask for, checked; None if they don't ask for one.

    Args:
        options: The fields of `Passes`; times and the error are texts.
    """
    if all(value in (None, False) for name, value in options.items() if name != "every"):
        return None
    for name, parsed in (("every", seconds_of), ("target_error", share_of), ("time_budget", seconds_of)):
        if options[name] is not None:
            options[name] = parsed(options[name])
    found = Passes(**options)
    found.check()
    return found


def seconds_of(text: str) -> float:
    """Parse a time: ``90``, ``90s``, ``10m``, ``1h30m``; raises `RenderError` if it isn't one, or is 0."""
    parts = re.findall(r"(\d+\.?\d*)([smhd]?)", text)
    seconds = sum(float(number) * UNITS[unit or "s"] for number, unit in parts)
    if "".join(number + unit for number, unit in parts) != text or not 0 < seconds < math.inf:
        raise RenderError(f"a time is a number with s, m, h or d, such as 90s or 1h30m; found '{text}'")
    return seconds


def share_of(text: str) -> float:
    """Parse a share: ``1%`` or ``0.01``; raises `RenderError` if it isn't one, or isn't above 0."""
    try:
        share = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        share = 0.0
    if not 0 < share < math.inf:
        raise RenderError(f"an error is a share above 0, such as 1% or 0.01; found '{text}'")
    return share
