"""Files written row by row hold what `djpt.write` writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import djpt
from djpt.errors import FileError, RenderError
from djpt.images.exr import read_attributes
from djpt.images.formats import Labels
from djpt.images.image import read_pixels
from djpt.images.row_files import is_streamed, writing_rows

Pixels = npt.NDArray[np.float32]


def noise(height: int, width: int, channels: int) -> Pixels:
    """Pixels that Deflate can't make smaller."""
    return np.random.default_rng(7).standard_normal((height, width, channels), np.float32)


def write_rows(path: Path, image: Pixels, step: int, labels: Labels | None = None, last: Labels | None = None) -> None:
    """Write an image, `step` rows at a time."""
    labels = labels or Labels(None, {})
    with writing_rows(path, image.shape, labels) as file:
        for first in range(0, len(image), step):
            file.add(image[first : first + step])
        file.close(last or labels)


@pytest.mark.parametrize("step", [1, 7, 16, 50])
@pytest.mark.parametrize("suffix", ["exr", "png", "hdr", "pfm", "npy", "bmp"])
def test_the_pixels_are_those_of_the_whole_image(suffix: str, step: int, tmp_path: Path) -> None:
    image = noise(37, 11, 3)
    write_rows(tmp_path / f"rows.{suffix}", image, step)
    djpt.write(tmp_path / f"whole.{suffix}", image)
    found, expected = (read_pixels(tmp_path / f"{name}.{suffix}") for name in ("rows", "whole"))
    np.testing.assert_array_equal(found, expected)
    assert is_streamed(tmp_path / f"a.{suffix}") == (suffix != "bmp")


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("suffix", ["exr", "png", "npy"])
def test_numbers_of_channels(suffix: str, channels: int, tmp_path: Path) -> None:
    image = noise(5, 3, channels)
    write_rows(tmp_path / f"rows.{suffix}", image, 2)
    djpt.write(tmp_path / f"whole.{suffix}", image)
    found, expected = (read_pixels(tmp_path / f"{name}.{suffix}") for name in ("rows", "whole"))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.usefixtures("second_thread")
@pytest.mark.parametrize("value", [None, 0.25, np.inf, np.nan])
def test_openexr_reads_what_is_written(value: float | None, tmp_path: Path) -> None:
    """Blocks that are compressed, and blocks that can't be."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    image = noise(35, 9, 3) if value is None else np.full((35, 9, 3), value, np.float32)
    write_rows(tmp_path / "a.exr", image, 10)
    np.testing.assert_array_equal(np.array(mi.Bitmap(str(tmp_path / "a.exr"))), image)


def test_layers_with_long_names_keep_their_order(tmp_path: Path) -> None:
    names = ("R", "G", "B", "A", "normal.Z", "a_name_of_more_than_thirty_one_letters.Y", "depth")
    image = noise(20, 4, len(names))
    write_rows(tmp_path / "a.exr", image, 3, Labels(names, {}))
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr"), image)
    assert {channel.name for channel in read_attributes(tmp_path / "a.exr")["channels"]} == set(names)


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_metadata_are_those_of_the_end(suffix: str, tmp_path: Path) -> None:
    begun, ended = {"spp": "64", "seconds": "0.00"}, {"spp": "12.3456", "seconds": "86400.25"}
    write_rows(tmp_path / f"a.{suffix}", noise(3, 3, 3), 1, Labels(None, begun), Labels(None, ended))
    assert djpt.read_metadata(tmp_path / f"a.{suffix}") == ended


def test_metadata_that_outgrow_the_header_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"a\.exr': the metadata have become too long"):
        write_rows(tmp_path / "a.exr", noise(3, 3, 3), 1, last=Labels(None, {"text": 500 * "x"}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [RenderError("a reason"), RuntimeError("another"), KeyboardInterrupt()])
def test_what_goes_wrong_meanwhile_passes_and_leaves_the_old_file(error: BaseException, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    path.write_text("old")
    with pytest.raises(type(error)) as caught, writing_rows(path, (64, 4, 3), Labels(None, {})) as file:
        file.add(noise(20, 4, 3))
        raise error
    assert caught.value is error
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])
