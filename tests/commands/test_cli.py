"""The command line: what it writes, what it prints where, and its exit codes."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import djpt
from djpt.apps.cli.console import ExitCode
from djpt.apps.cli.main import COMMANDS, main
from djpt.errors import BackendError, DjptError, FileError, RenderError
from djpt.images.image import read_pixels
from djpt.rendering.progress import short
from tests.kit.commands import run

SMALL = ["cornell_box", "--width", "16", "--spp", "4"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def process(*arguments: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "djpt", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **(environment or {})},
        timeout=120,
    )


# ---------------------------------------------------------------- render


def test_render_writes_the_image_that_python_renders() -> None:
    code, out, err = run("render", *SMALL, "--seed", "3", "-o", "a.exr")
    assert code == ExitCode.DONE, err
    assert out.startswith("a.exr: 16 x 16, 4 spp, ")
    assert out.endswith("samples/s\n")
    assert err == ""
    description = djpt.cornell_box()
    description["sensor"]["film"].update(width=16, height=16)
    image = djpt.render(djpt.load_dict(description), spp=4, seed=3)
    np.testing.assert_array_equal(read_pixels("a.exr"), image.numpy())


def test_render_has_defaults() -> None:
    code, out, _ = run("render", *SMALL, "--rfilter", "box", "--integrator", "direct", "--height", "8")
    assert code == ExitCode.DONE
    assert out.startswith("cornell_box.exr: 16 x 8, ")
    assert Path("cornell_box.exr").exists()


def test_render_takes_the_sensor_that_was_asked_for() -> None:
    meter = "<sensor type='radiancemeter'><film type='hdrfilm'><integer name='width' value='1'/>"
    meter += "<integer name='height' value='1'/></film></sensor></scene>"
    Path("two.xml").write_text(FILE.replace("$spp", "2").replace("</scene>", meter))
    code, out, err = run("render", "two.xml", "--sensor", "1", "--width", "8", "-o", "a.npy")
    assert (code, err) == (ExitCode.DONE, "")
    assert out.startswith("a.npy: 1 x 1, 4 spp")
    assert run("render", "two.xml", "--width", "8", "-o", "b.npy")[1].startswith("b.npy: 8 x 4, 2 spp")
    code, _, err = run("render", "two.xml", "--sensor", "2")
    assert (code, "there is no sensor 2: the scene has 2, numbered from 0" in err) == (ExitCode.BAD_INPUT, True)


def test_files_say_how_they_were_rendered() -> None:
    for name in ("a.exr", "a.png", "a.npy"):
        assert run("render", *SMALL, "--seed", "7", "-q", "-o", name)[0] == ExitCode.DONE
    for name in ("a.exr", "a.png"):
        facts = djpt.read_metadata(name)
        assert float(facts.pop("seconds")) >= 0
        expected = {"scene": "cornell_box", "integrator": "path", "sampler": "independent", "spp": "4", "seed": "7"}
        assert {key: facts[key] for key in expected} == expected
        assert facts["Software"] == f"djpt {djpt.__version__}"


# ---------------------------------------------------------------- tone mapping


def test_render_and_tonemap_make_the_same_picture() -> None:
    options = ["--tonemap", "agx", "--exposure", "1.5", "--white-balance", "5000"]
    assert run("render", *SMALL, "-q", "-o", "a.exr")[0] == ExitCode.DONE
    assert run("render", *SMALL, "-q", "-o", "a.png", *options)[0] == ExitCode.DONE
    assert run("tonemap", "a.exr", "-o", "b.png", *options) == (ExitCode.DONE, "b.png: 16 x 16\n", "")
    np.testing.assert_array_equal(read_pixels("a.png"), read_pixels("b.png"))
    expected = djpt.tonemap(read_pixels("a.exr"), "agx", 1.5, 5000)
    djpt.write("c.png", expected)
    np.testing.assert_array_equal(read_pixels("a.png"), read_pixels("c.png"))
    assert djpt.read_metadata("b.png")["scene"] == "cornell_box"
    assert djpt.read_metadata("b.png")["tonemap"] == "agx"
    assert run("tonemap", "a.exr", "--exposure", "auto", "--white-balance", "1,0.8,0.6", "-q")[0] == ExitCode.DONE


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", *SMALL, "-o", "a.png", "--tonemap", "acse"], "did you mean 'aces'?"),
        (["render", *SMALL, "-o", "a.exr", "--tonemap", "aces"], "png or jpg, found 'a.exr'"),
        (["render", *SMALL, "-o", "a.png", "--exposure", "bright"], "found 'bright'"),
        (["render", *SMALL, "-o", "a.png", "--white-balance", "1,2"], "found [1.0, 2.0]"),
        (["tonemap", "a.exr"], "can't read 'a.exr': there is no such file"),
    ],
)
def test_wrong_tone_mapping_is_found_before_rendering(arguments: list[str], message: str) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (ExitCode.BAD_INPUT, "")
    assert message in err
    assert list(Path().iterdir()) == []


# ---------------------------------------------------------------- scene files

FILE = """<scene version="3.0.0">
<default name="size" value="16"/><integrator type="path"/>
<sensor type="perspective">
<film type="hdrfilm"><integer name="width" value="$size"/><integer name="height" value="8"/><rfilter type="box"/></film>
<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
</sensor>
<shape type="sphere"><point name="center" x="0" y="0" z="3"/></shape>
<emitter type="constant"/>
</scene>"""


def test_a_scene_file_with_parameters() -> None:
    Path("ball.xml").write_text(FILE)
    code, out, err = run("render", "ball.xml", "-D", "spp=4", "-D", "size=12")
    assert code == ExitCode.DONE, err
    assert out.startswith("ball.exr: 12 x 8, 4 spp, ")
    image = djpt.render(djpt.load_file("ball.xml", spp=4, size=12))
    np.testing.assert_array_equal(read_pixels("ball.exr"), image.numpy())
    assert run("info", "ball.xml", "-D", "spp=4")[0] == ExitCode.DONE


def test_compare_takes_scene_files() -> None:
    pytest.importorskip("mitsuba")
    Path("ball.xml").write_text(FILE)
    code, out, err = run("compare", "ball.xml", "-D", "spp=4", "--spp", "16")
    assert code == ExitCode.DONE, out + err
    assert out.startswith("ball, 16 x 8: djpt at 16 spp")
    assert Path("ball_comparison.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ball.xml"], "ball.xml:5: <integer>: 'value': unknown parameter '$spp'"),
        (["ball.xml", "-D", "spp=x"], "ball.xml:5: <integer>: must be a whole number, found 'x'"),
        (["ball.xml", "-D", "spp=0"], "ball.xml:5: scene.sensor.sampler: 'sample_count' must be at least 1, found 0"),
        (["ball.xml", "-D", "spp=1", "-D", "sise=2"], "the parameter 'sise' isn't used; did you mean 'size'?"),
        (["ball.xml", "-D", "spp"], "-D takes NAME=VALUE, found 'spp'"),
        (["cornell_box", "-D", "spp=1"], "only scene files (XML) have parameters, found spp for 'cornell_box'"),
        (["ball"], "unknown scene 'ball'; the file would be 'ball.xml'"),
    ],
)
@pytest.mark.parametrize("command", ["render", "compare", "info"])
def test_wrong_scene_files(command: str, arguments: list[str], message: str) -> None:
    Path("ball.xml").write_text(FILE)
    code, out, err = run(command, *arguments)
    assert (code, out) == (ExitCode.BAD_INPUT, "")
    assert message in err


def test_quiet_prints_nothing() -> None:
    assert run("render", *SMALL, "-o", "a.png", "--quiet") == (ExitCode.DONE, "", "")
    assert Path("a.png").exists()


def test_no_bar_in_a_pipe() -> None:
    done = process("render", *SMALL, "-o", "a.png")
    assert done.returncode == 0
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) == 1


def test_bar_on_a_terminal() -> None:
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    command = [sys.executable, "-m", "djpt", "render", *SMALL, "-o", "a.png"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, env=environment) as child:
        os.close(theirs)
        shown = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            shown += piece
        assert child.stdout is not None
        out = child.stdout.read()
    os.close(ours)
    assert child.returncode == 0
    assert b"rendering" in shown and b"100%" in shown
    assert out.startswith(b"a.png: 16 x 16")


def test_speeds_are_short() -> None:
    assert [short(x) for x in (0.5, 12.0, 13_540.0, 13.54e6, 1.2e9)] == [
        "0.5 ",
        "12 ",
        "13.5 k",
        "13.5 M",
        "1.2 G",
    ]


# ---------------------------------------------------------------- errors


def test_misspelt_commands() -> None:
    code, _, err = run("rendr", "cornell_box")
    assert code == ExitCode.BAD_INPUT
    assert "unknown command 'rendr'; did you mean 'render'? (possible: render, " in err
    assert "unknown command 'zzz'; possible: animate, benchmarks, bounces, compare" in run("zzz")[2]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "cornel_box"], "unknown scene 'cornel_box'; did you mean 'cornell_box'?"),
        (["render", "scene.xml"], "can't read 'scene.xml': there is no such file"),
        (["render", "nowhere/cornel_box.xml"], "can't read 'nowhere/cornel_box.xml': there is no such file\n"),
        (["render", "cornel_box.xml"], "no such file; did you mean the built-in scene 'cornell_box'?"),
        (["compare", "cornell_box", "--integrator", "pth"], "unknown integrator 'pth'; did you mean 'path'?"),
        (
            ["render", "glass_ball", *SMALL[1:], "--adaptive"],
            "the integrator 'bdpt' can't render adaptively; possible: path, ",
        ),
        (["validate", "--integrator", "depth"], "'depth' can't find the light of any of the cases; possible: bdpt, "),
        (["render", "cornell_box", "-o", "a.exe"], "unknown extension 'exe'; did you mean 'exr'?"),
        (["render", "cornell_box", "-o", "nowhere/a.exr"], "there is no folder"),
        (["render", "cornell_box", "--spp", "0"], "--spp must be at least 1, found 0"),
        (["render", "cornell_box", "--spp", "-1"], "--spp must be at least 1, found -1"),
        (["render", "cornell_box", "--width", "0"], "--width must be at least 1, found 0"),
        (["render", "cornell_box", "--seed", "-1", "--width", "4", "--spp", "1"], "seed"),
        (["render", "cornell_box", "--integrator", "paht"], "did you mean 'path'?"),
        (["render", "cornell_box", "--rfilter", "bix"], "did you mean 'box'?"),
        (["render", "cornell_box", "--schedule", "fast", "--width", "4", "--spp", "1"], "unknown schedule 'fast'"),
        (["compare", "cornel_box"], "did you mean 'cornell_box'?"),
        (["compare", "cornell_box", "-o", "a.gif"], "gif is for movies"),
        (["render", "cornell_box", "-o", "a.gif"], "can't write 'a.gif': gif is for movies, which 'djpt turntable'"),
        (["render", "a.gif"], "'a.gif' is a movie and not a scene; a scene is an XML file, such as 'scene.xml', or"),
        (["info", "a.PNG"], "'a.PNG' is a picture and not a scene; a scene is an XML file"),
        (["view", "a.ply"], "can't read 'a.ply': there is no such file"),
        (["turntable", "cornell_box", "-o", "a.gif"], "-o takes a folder for the frames; the movie: --movie a.gif"),
        (["compare", "cornell_box", "-o", "a.exr"], "png or a jpg"),
        (["compare", "cornell_box", "--spp", "2"], "'spp' must be an integer of at least 4"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments: list[str], message: str) -> None:
    code, out, err = run(*arguments)
    assert code == ExitCode.BAD_INPUT
    assert out == ""
    assert message in err
    assert err.startswith("djpt: error: ")
    assert len(err.splitlines()) == 1
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("arguments", [["render"], ["rendr", "x"], ["render", "cornell_box", "--spp", "many"], []])
def test_wrong_usage_is_exit_code_2(arguments: list[str]) -> None:
    code, out, err = run(*arguments)
    assert code == ExitCode.BAD_INPUT
    assert "Usage" in out + err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RenderError("a\nb"), ExitCode.BAD_INPUT),
        (FileError("disk full"), ExitCode.BAD_INPUT),
        (DjptError("any"), ExitCode.BAD_INPUT),
        (MemoryError(), ExitCode.BAD_INPUT),
        (BackendError("no LLVM\n    do this"), ExitCode.UNUSABLE),
        (KeyboardInterrupt(), ExitCode.INTERRUPTED),
    ],
)
def test_errors_have_exit_codes(
    error: BaseException, code: ExitCode, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("djpt.scenes.overrides.described", fail)
    monkeypatch.setattr(sys, "argv", ["djpt", "render", "cornell_box"])
    assert main() == code
    err = capsys.readouterr().err
    assert err.startswith("djpt: error: ")
    assert "Traceback" not in err


def test_no_usable_backend_is_exit_code_3() -> None:
    done = process("render", *SMALL, environment={"DJPT_VARIANT": "llvm_mono"})
    assert done.returncode == ExitCode.UNUSABLE
    assert "the variant 'llvm_mono' isn't available" in done.stderr
    assert "Traceback" not in done.stderr


def test_comparing_without_mitsuba_is_exit_code_3(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)  # import raises ImportError
    code, _, err = run("compare", *SMALL)
    assert code == ExitCode.UNUSABLE
    assert "pip install mitsuba==3.9.1" in err


# ---------------------------------------------------------------- compare, scenes, doctor


def test_compare_prints_a_table_and_writes_a_picture() -> None:
    pytest.importorskip("mitsuba")
    code, out, err = run("compare", "cornell_box", "--width", "24", "--spp", "16", "--rfilter", "box", "--rmse", "1")
    assert code == ExitCode.DONE, out + err
    assert err == ""
    assert "RMSE" in out and "same seed" in out and "\npassed\n" in out
    assert Path("cornell_box_comparison.png").read_bytes().startswith(b"\x89PNG")
    assert "picture: cornell_box_comparison.png" in out


def test_a_difference_is_exit_code_1() -> None:
    pytest.importorskip("mitsuba")
    code, out, _ = run("compare", "cornell_box", "--width", "16", "--spp", "8", "--rmse", "1e-6", "--no-picture")
    assert code == ExitCode.DIFFERENT
    assert out.rstrip().endswith("FAILED")
    assert list(Path().iterdir()) == []


def test_scenes_are_listed() -> None:
    code, out, _ = run("scenes")
    assert code == ExitCode.DONE
    names = [line.split()[0] for line in out.splitlines()]
    assert "cornell_box" in names
    assert names == sorted(names)
    assert all(len(line.split(maxsplit=1)) == 2 for line in out.splitlines()), "each with a summary"


@pytest.mark.slow
def test_doctor_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, _ = run("doctor")
    assert code == ExitCode.DONE
    assert "LLVM" in out
    monkeypatch.setattr("djpt.apps.cli.doctor.main", lambda: 3)
    assert run("doctor")[0] == ExitCode.UNUSABLE


def test_version_and_help() -> None:
    assert run("--version") == (ExitCode.DONE, f"djpt {djpt.__version__}\n", "")
    code, out, _ = run("--help")
    assert code == ExitCode.DONE
    for command in ("render", "compare", "scenes", "doctor"):
        assert command in out
    assert run("render", "-h")[0] == ExitCode.DONE


@pytest.mark.parametrize("command", ["--help", "--version"])
def test_help_needs_no_backend(command: str) -> None:
    done = process(command, environment={"DJPT_VARIANT": "none_such"})
    assert done.returncode == 0, done.stderr


def test_help_lists_all_commands_in_whole_sentences() -> None:
    code, out, _ = run("--help")
    listed = out.split("Commands:\n")[1].splitlines()
    assert (code, [line.split()[0] for line in listed]) == (ExitCode.DONE, list(COMMANDS))
    assert all(line.endswith(".") and not line.endswith("..") for line in listed)


def test_shells_complete_commands_and_scenes() -> None:
    environment = {"_DJPT_COMPLETE": "bash_complete", "COMP_WORDS": "djpt render cornell", "COMP_CWORD": "2"}
    found = process(environment=environment).stdout.split()
    assert {"plain,cornell_box", "file,cornell"} <= set(found)
    environment.update(COMP_WORDS="djpt re", COMP_CWORD="1")
    assert process(environment=environment).stdout.split() == ["plain,render"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the device that is always full is Linux's")
def test_a_full_disk_at_stdout_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "djpt", "scenes"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr == "djpt: error: can't write to the standard output: no space left on device\n"
