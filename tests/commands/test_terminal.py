"""Nothing that the command line prints makes a terminal do anything but show it, whatever names and files hold."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest

import djpt
from djpt.apps.cli.main import COMMANDS, main
from djpt.core.terminal import VisibleText, beneath, show_all, visible

EVIL = "e\x1b]0;owned\x07\x1b[5mvil\x9b2J\u202e\u2066\x7f\rgone\u2028\udcff"
"""A window's title, blinking, a cleared screen, overrides of direction, the start of a line, and a broken byte."""
EVIL_XML = "e\x9b2J\u202e\u2066\x7fvil\x85"
"""As much of it as an attribute in XML can hold."""
OURS = re.compile(r"\r?\x1b\[(\d+(;\d+)*m|2K|1A|\?25[lh])|\r")
"""What djpt and `rich` tell a terminal, to show bars and colours."""
BLINKING = "\x1b[5m"


class Terminal(io.StringIO):
    """A terminal that remembers what it was told."""

    encoding = "utf-8"  # type: ignore[assignment]

    def isatty(self) -> bool:
        return True


Asked = Callable[..., str]


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Runs the command line, stdout and stderr being one terminal, and gives what was written to it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("PYTHON_COLORS", "0")

    def ask(*arguments: str) -> str:
        terminal = Terminal()
        monkeypatch.setattr(sys, "argv", ["djpt", *arguments])
        monkeypatch.setattr(sys, "stdout", terminal)
        monkeypatch.setattr(sys, "stderr", terminal)
        show_all()
        main()
        return terminal.getvalue()

    return ask


def assert_only_shown(text: str) -> None:
    """Fail if a terminal would obey anything but what djpt itself tells it."""
    assert BLINKING not in text and "\rgone" not in text, ascii(text)
    left = OURS.sub("", text)
    assert visible(left, kept="\n") == left, ascii(text)


def scene_file(path: str, **parts: str) -> str:
    """A scene whose names are evil."""
    name = quoteattr(EVIL_XML, {character: f"&#{ord(character)};" for character in EVIL_XML if ord(character) < 0xA0})
    Path(path).write_text(
        f"""<scene version="3.0.0">
            <integrator type="path"/>
            <sensor type="perspective"><film type="hdrfilm">
                <integer name="width" value="4"/><integer name="height" value="4"/>
            </film></sensor>
            <bsdf type="diffuse" id={name}/>
            <shape type="rectangle"><ref id={parts.get("bsdf", name)}/></shape>
            <emitter type="area" id={quoteattr("lamp" + EVIL_XML[1:4])}/>
            <emitter type="constant"/>
            {parts.get("more", "")}
        </scene>""",
        "utf-8",
    )
    return path


NEEDED = {
    "denoise": ("--denoiser", "nlm"),
    "merge": ("-o", "a.djpt"),
    "turntable": ("-o", "a"),
    "animate": ("-o", "a", "--set", "x=0:1;5:2"),
}
"""Options without which a command doesn't look at its files."""


# ---- any command ---------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_options_that_are_unknown(asked: Asked, command: str) -> None:
    text = asked(command, f"--{EVIL}")
    assert_only_shown(text)
    assert r"--e\x1b]0;owned\x07\x1b[5mvil\x9b2J\u202e\u2066\x7f" in text or "--e" in text


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in ("doctor", "scenes", "worker")])
def test_scenes_and_files_that_are_missing(asked: Asked, command: str) -> None:
    text = asked(command, f"{EVIL}.{'exr' if command in ('denoise', 'tonemap') else 'xml'}", *NEEDED.get(command, ()))
    assert_only_shown(text)
    assert r"\x1b]0;owned" in text


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in ("doctor", "scenes", "worker")])
def test_values_of_options(asked: Asked, command: str) -> None:
    first = {"denoise": "a.exr", "tonemap": "a.exr", "merge": "a.djpt"}.get(command, "cornell_box")
    for option in ("-o", "--seed", "--rfilter", "--integrator", "-D", "--schedule"):
        assert_only_shown(asked(command, first, option, EVIL, f"--{EVIL}"))


def test_commands_that_are_unknown(asked: Asked) -> None:
    text = asked(EVIL)
    assert_only_shown(text)
    assert "unknown command" in text


def test_the_help(asked: Asked) -> None:
    assert_only_shown(asked("--help"))
    assert_only_shown(asked("render", "--help"))


# ---- names in scenes -----------------------------------------------------------------------------

SHOWN = r"e\x9b2J\u202e\u2066\x7fvil\x85"


def test_names_in_errors_and_warnings(asked: Asked) -> None:
    file = scene_file("a.xml", bsdf='"missing"')
    for command in ("render", "info", "compare"):
        text = asked(command, file)
        assert_only_shown(text)
        assert "nothing has the id 'missing'" in text
    group = f'<shape type="shapegroup" id={quoteattr(EVIL_XML[1:])}><shape type="sphere"/></shape>'
    file = scene_file("b.xml", more=group)
    with pytest.warns(UserWarning, match="no shape refers to this emitter"):
        text = asked("info", file)
    assert_only_shown(text)
    assert r"in \x9b2J\u202e\u2066\x7fvil\x85" in text


def test_warnings_are_printed_visibly(asked: Asked, tmp_path: Path) -> None:
    file = scene_file("c.xml")
    done = subprocess.run(
        [sys.executable, "-m", "djpt", "info", file], capture_output=True, check=False, env={**os.environ}, timeout=120
    )
    text = done.stderr.decode()
    assert "no shape refers to this emitter" in text
    assert text.startswith("djpt: warning: ") and len(text.splitlines()) == 1  # without the line of the code
    assert_only_shown(text)
    assert r"lamp\x9b2J" in text


@pytest.mark.slow
def test_names_of_parameters(asked: Asked) -> None:
    file = scene_file("d.xml")
    with pytest.warns(UserWarning, match="no shape refers to this emitter"):
        text = asked("gradcheck", file, f"{EVIL_XML}.reflectance.value", "--spp", "2", "--samples", "2")
    assert_only_shown(text)
    with pytest.warns(UserWarning, match="no shape refers to this emitter"):
        text = asked("gradcheck", file, f"{EVIL}.x")
    assert_only_shown(text)
    for definition in (EVIL, f"{EVIL}=1", f"a={EVIL}"):
        text = asked("render", file, "-D", definition)
        assert_only_shown(text)
        assert "djpt: error: " in text


# ---- files ---------------------------------------------------------------------------------------


def test_names_of_files_that_are_written(asked: Asked) -> None:
    name = EVIL[:-1]  # OpenEXR reads names of UTF-8 only
    for command, *arguments in (
        ("render", "cornell_box", "--width", "4", "--spp", "1", "-o", f"{name}.exr"),
        ("tonemap", f"{name}.exr", "-o", f"{name}.png"),
        ("denoise", f"{name}.exr", "-o", f"{name}2.exr", "--denoiser", "nlm"),
        ("compare", f"{name}.exr", f"{name}2.exr"),
    ):
        text = asked(command, *arguments)
        assert_only_shown(text)
        if command != "compare":
            assert visible(name) in text, ascii(text)
    assert Path(f"{name}.png").exists()


def test_names_of_channels(asked: Asked) -> None:
    names = [f"{EVIL[:-1]}.{channel}" for channel in "XYZ"]
    djpt.write("layers.exr", np.ones((4, 4, 6), np.float32), channels=["R", "G", "B", *names])
    for command, *arguments in (
        ("denoise", "layers.exr", "-o", "clean.png", "--denoiser", "nlm"),
        ("denoise", "layers.exr", "-o", "clean.exr", "--albedo", EVIL),
        ("tonemap", "layers.exr"),
        ("compare", "layers.exr", "layers.exr"),
    ):
        assert_only_shown(asked(command, *arguments))
    djpt.write("odd.exr", np.ones((4, 4, 3), np.float32), channels=names)
    text = asked("denoise", "odd.exr", "-o", "clean.png", "--denoiser", "nlm")
    assert_only_shown(text)
    assert r"e\x1b]0;owned" in text


# ---- what isn't djpt's ---------------------------------------------------------------------------


def test_the_doctor(asked: Asked, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("DJPT_VARIANT", "DJPT_LIBLLVM_PATH", "DJPT_RAY_QUERIES"):
        monkeypatch.setenv(variable, EVIL)
    text = asked("doctor")
    assert_only_shown(text)
    assert r"\x1b]0;owned" in text


def test_tracebacks_of_exceptions_that_nobody_expected() -> None:
    code = f"""import sys
import djpt.apps.cli.info
from djpt.apps.cli.main import run
def fail():
    raise RuntimeError({EVIL!r})
djpt.apps.cli.info.scenes.callback = fail
sys.argv = ["djpt", "scenes"]
run()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=120)
    text = done.stderr.decode()
    assert "RuntimeError: e\\x1b]0;owned" in text
    assert_only_shown(text)


def test_what_is_printed_while_a_bar_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    from djpt.rendering.progress import progress_bar

    terminal = Terminal()
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", terminal)
    with progress_bar(f"{EVIL} [bold]{{x}}", "samples", quiet=False) as show:
        show(1, 2)
        print(EVIL)
        print(EVIL, file=sys.stderr)
    text = terminal.getvalue()
    assert_only_shown(text)
    assert "[bold]{x}" in text and text.count(r"e\x1b]0;owned") >= 3
    assert sys.stdout is terminal and sys.stderr is terminal


def test_what_is_visible_stays() -> None:
    for text in ("plain", "Grüße, 世界, \u00a0\u3000", "🦊 ∂x/∂y", ""):
        assert visible(text) == text
    assert visible("a\nb\tc\r\x00") == r"a\nb\tc\r\x00"
    assert visible("a\nb\tc\r", kept="\n\t") == "a\nb\tc\\r"


def test_the_stream_is_one_of_text() -> None:
    terminal = Terminal()
    stream = VisibleText(terminal)
    assert stream.write("a\x1b") == 2 and terminal.getvalue() == r"a\x1b"
    assert stream.buffer.write("é\x07".encode() + b"\xff") == 4 and terminal.getvalue() == r"a\x1bé\x07\udcff"
    assert stream.isatty() and stream.writable() and stream.encoding == "utf-8"
    assert beneath(stream) is terminal and beneath(terminal) is terminal
