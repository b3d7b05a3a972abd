"""`render_to_file` writes the bits of `render`, whatever the bands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import FileError, RenderError
from djpt.images.image import read_pixels
from djpt.rendering.schedules import passes
from djpt.scene.scene import Scene
from tests.kit.mesh_scenes import ball_file

PATH = {"type": "path", "max_depth": 3}
AOVS = {"type": "aov", "aovs": "a:albedo,n:sh_normal,shape:shape_index", "img": PATH}
LIGHT = {"type": "ptracer", "max_depth": 3}
CENTRES = {"type": "aov", "aovs": "shape:shape_index"}


def box(integrator: dict[str, Any] = PATH, rfilter: str = "box", **film: Any) -> Scene:
    """A Cornell box of 24 x 19 pixels."""
    description = djpt.cornell_box()
    description["sensor"]["film"].update({"width": 24, "height": 19, "rfilter": {"type": rfilter}, **film})
    description["integrator"] = integrator
    return djpt.load_dict(description)


@pytest.fixture
def small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands of a few rows."""
    monkeypatch.setattr(passes, "SUMMED_PIXELS", 100)
    monkeypatch.setattr(passes, "FILTERED_PIXELS", 100)
    monkeypatch.setattr(passes, "STORED_PIXELS", (75, 100))


@pytest.mark.sparse(9)
@pytest.mark.usefixtures("small_bands")
@pytest.mark.parametrize("keep_partial", [False, True])
@pytest.mark.parametrize("border", [False, True])
@pytest.mark.parametrize("schedule", ["flat", "wave"])
@pytest.mark.parametrize("rfilter", ["box", "gaussian", "mitchell"])
def test_the_file_has_the_bits_of_the_image(
    rfilter: str, schedule: str, border: bool, keep_partial: bool, tmp_path: Path
) -> None:
    scene = box(rfilter=rfilter, sample_border=border)
    options: dict[str, Any] = {"spp": 5, "seed": 2, "schedule": schedule}
    djpt.render_to_file(scene, tmp_path / "a.npy", pass_spp=2, keep_partial=keep_partial, **options)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.npy"), djpt.render(scene, **options).numpy())


@pytest.mark.sparse(2)
@pytest.mark.parametrize(
    "integrator", [AOVS, CENTRES, {"type": "ptracer", "max_depth": 3}], ids=lambda i: str(i["type"])
)
@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
def test_layers_and_images_that_are_made_as_a_whole(
    integrator: dict[str, Any], rfilter: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = box(integrator, rfilter)
    image = djpt.render(scene, spp=3)
    monkeypatch.setattr(passes, "SUMMED_PIXELS", 100)
    monkeypatch.setattr(passes, "STORED_PIXELS", (75, 100))
    monkeypatch.setattr("djpt.rendering.progressive.to_file.SUMMED_PIXELS", 100)
    djpt.render_to_file(scene, tmp_path / "a.exr", spp=3)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr"), image.numpy())


@pytest.mark.usefixtures("small_bands")
@pytest.mark.parametrize("queries", ["auto", "steps"])
def test_meshes(queries: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DJPT_RAY_QUERIES", queries)
    description = djpt.cornell_box()
    description["mesh"] = {"type": "ply", "filename": str(ball_file(tmp_path))}
    description["sensor"]["film"].update(width=24, height=19)
    scene = djpt.load_dict(description)
    djpt.render_to_file(scene, tmp_path / "a.exr", spp=2)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr"), djpt.render(scene, spp=2).numpy())


def test_files_say_what_they_are(tmp_path: Path) -> None:
    djpt.render_to_file(box(), tmp_path / "a.exr", spp=2, seed=9, metadata={"job": "cover"})
    facts = djpt.read_metadata(tmp_path / "a.exr")
    assert re.fullmatch(r"\d+\.\d\d", facts.pop("seconds")), "0.00 for less than 5 ms, with kernels of another test"
    expected = {"integrator": "path", "sampler": "independent", "sensor": "0", "spp": "2", "seed": "9", "job": "cover"}
    assert facts == {"Software": f"djpt {djpt.__version__}", **expected}


def test_parts_are_converted(tmp_path: Path) -> None:
    """Tone mapping by parts is tone mapping of the image; what needs all of it gets it."""
    scene = box(AOVS)
    image = djpt.render(scene, spp=2).numpy()[..., :3]
    djpt.render_to_file(scene, tmp_path / "a.png", spp=2, convert=lambda rows: djpt.tonemap(rows[..., :3], "agx"))
    djpt.write(tmp_path / "b.png", djpt.tonemap(image, "agx"))
    seen = []

    def automatic(pixels: Any) -> Any:
        seen.append(pixels.shape)
        return djpt.tonemap(pixels[..., :3], exposure="auto")

    djpt.render_to_file(scene, tmp_path / "c.png", spp=2, convert=automatic, convert_at_once=True)
    djpt.write(tmp_path / "d.png", djpt.tonemap(image, exposure="auto"))
    for found, expected in ("ab", "cd"):
        np.testing.assert_array_equal(read_pixels(tmp_path / f"{found}.png"), read_pixels(tmp_path / f"{expected}.png"))
    assert seen[1:] == [(19, 24, 10)]


def test_gradients_are_left_alone(tmp_path: Path) -> None:
    scene = box()
    params = djpt.traverse(scene)
    dr.enable_grad(params["red.reflectance.value"])
    params.update()
    djpt.render_to_file(scene, tmp_path / "a.exr", spp=2)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr"), djpt.render(scene, params, spp=2).numpy())


def test_an_integrator_of_a_script_that_renders_by_itself(tmp_path: Path) -> None:
    class Grey(djpt.Integrator):
        """Renders half of everything."""

        def render(self, scene: Any, sensor: Any = 0, *args: Any, **kwargs: Any) -> Any:
            return djpt.TensorXf(dr.full(djpt.Float, 0.5, 24 * 19 * 3), shape=(19, 24, 3))

    djpt.render_to_file(box(), tmp_path / "a.exr", integrator=Grey(djpt.Properties("grey", "integrator", {})))
    assert (read_pixels(tmp_path / "a.exr") == 0.5).all()


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("a.exe", {}, FileError, "did you mean 'exr'"),
        ("a.png", {"integrator": AOVS}, FileError, "png holds 1 to 4 channels, found 10"),
        ("a.exr", {"schedule": "flat", "integrator": CENTRES}, RenderError, "use schedule='wave'"),
        ("a.exr", {"spp": -1}, RenderError, "'spp' must be"),
        ("a.exr", {"pass_spp": 0.5}, RenderError, "'pass_spp' must be"),
        ("a.exr", {"seed": -1}, RenderError, "'seed' must be"),
        ("a.exr", {"metadata": {"type": "x"}}, FileError, "is used by the format itself"),
    ],
)
def test_mistakes_leave_nothing(
    name: str, options: dict[str, Any], error: type[Exception], message: str, tmp_path: Path
) -> None:
    integrator = options.pop("integrator", PATH)
    with pytest.raises(error, match=message):
        djpt.render_to_file(box(integrator), tmp_path / name, **{"spp": 1, **options})
    assert list(tmp_path.iterdir()) == []


def test_an_image_in_memory_that_does_not_fit_names_the_way_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("djpt.core.memory.free_memory", lambda: 2**30)
    scene = box(width=9000, height=9000)
    with pytest.raises(RenderError, match=r"9000 x 9000 .* takes about .*write it row by row \(djpt.render_to_file\)"):
        djpt.render(scene, spp=1)
    with pytest.raises(RenderError, match=r"takes about 1\.5 GiB"):
        djpt.render_to_file(box(LIGHT, width=9000, height=9000), tmp_path / "a.exr", spp=1)
    with pytest.raises(RenderError, match=r"takes about 1\.5 GiB"):
        djpt.render_to_file(scene, tmp_path / "a.bmp", spp=1)
    assert list(tmp_path.iterdir()) == []
