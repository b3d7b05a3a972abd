"""Bitmaps beside Mitsuba's: the same calls, the same results."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import djpt
from djpt.errors import FileError, SceneError
from djpt.images.bitmap import Bitmap
from djpt.images.resampler import FilterBoundaryCondition
from djpt.images.structs import Flags, Struct, Type

FORMATS = ("Y", "YA", "RGB", "RGBA", "RGBAW", "XYZ", "XYZA")
COUNTS = ("width", "height", "pixel_count", "channel_count", "has_alpha", "bytes_per_pixel", "buffer_size")
TYPES = ("UInt8", "UInt16", "UInt32", "Int8", "Int16", "Int32", "Float16", "Float32", "Float64")


@pytest.fixture
def mi(second_thread: None) -> Any:
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def numbers(form: str, kind: str, seed: int = 0) -> np.ndarray:
    """Pixels (5, 7, C) of a type; the first ones are 0."""
    share = np.random.default_rng(seed).random((5, 7, len(form)))
    share[0, :2] = 0
    dtype = np.dtype(kind.lower())
    return (share * np.iinfo(dtype).max).astype(dtype) if dtype.kind in "iu" else share.astype(dtype)


def both(mi: Any, pixels: np.ndarray, form: str, **flags: bool) -> tuple[Bitmap, Any]:
    """The same bitmap here and there."""
    ours, theirs = Bitmap(pixels, Bitmap.PixelFormat[form]), mi.Bitmap(pixels, getattr(mi.Bitmap.PixelFormat, form))
    for bitmap in (ours, theirs):
        for name, value in flags.items():
            getattr(bitmap, f"set_{name}")(value)
    return ours, theirs


def facts(bitmap: Any) -> dict[str, Any]:
    """All that a bitmap says of itself, in plain Python."""
    fields = bitmap.struct_()
    return {
        **{name: getattr(bitmap, name)() for name in COUNTS},
        "flags": [(field.name, int(field.flags), field.offset, field.type.value) for field in fields],
        "srgb": (bitmap.srgb_gamma(), bitmap.premultiplied_alpha()),
        "size": [int(count) for count in bitmap.size()],
        "type": (bitmap.pixel_format().name, bitmap.component_format().name),
        "text": repr(bitmap).split("data =")[0].split("metadata")[0],
    }


# ---- what it is ----------------------------------------------------------------------------


@pytest.mark.parametrize(("form", "kind"), list(itertools.product(FORMATS, TYPES)))
def test_a_bitmap_of_an_array_describes_itself_as_mitsubas(mi: Any, form: str, kind: str) -> None:
    ours, theirs = both(mi, numbers(form, kind), form)
    assert facts(ours) == facts(theirs)
    np.testing.assert_array_equal(np.array(ours), np.array(theirs))
    assert np.array(ours).dtype == np.array(theirs).dtype
    for value in (True, False):
        for bitmap in (ours, theirs):
            bitmap.set_srgb_gamma(value)
            bitmap.set_premultiplied_alpha(not value)
        assert facts(ours) == facts(theirs)


@pytest.mark.parametrize("name", ["PixelFormat", "FileFormat", "AlphaTransform"])
def test_enumerations_have_mitsubas_values(mi: Any, name: str) -> None:
    theirs = {member.name: member.value for member in getattr(mi.Bitmap, name)}
    assert theirs.items() <= {n: m.value for n, m in getattr(Bitmap, name).__members__.items()}.items()
    for kind in Type:
        assert getattr(Bitmap, kind.name) is kind
        assert getattr(mi.Struct.Type, kind.name).value == kind.value


def test_channels_are_named_as_mitsubas(mi: Any) -> None:
    many = np.zeros((2, 3, 11), np.float32)
    for array, names in (
        (many, []),
        (many, [f"c.{i}" for i in range(11)]),
        (np.zeros((2, 3, 2), np.float32), ["a", "b"]),
    ):
        ours, theirs = Bitmap(array, channel_names=names), mi.Bitmap(array, channel_names=names)
        assert [field.name for field in ours.struct_()] == [field.name for field in theirs.struct_()]
        assert ours.pixel_format().name == theirs.pixel_format().name
    ours = Bitmap(Bitmap.PixelFormat.MultiChannel, Type.Float16, [4, 5], 3, ["x", "y", "z"])
    assert list(ours.size()) == [4, 5]
    assert [field.name for field in ours.struct_()] == ["x", "y", "z"]


def test_arrays_share_the_memory_and_tensors_take_it() -> None:
    bitmap = Bitmap(Bitmap.PixelFormat.RGB, Type.Float32, (3, 2))
    np.array(bitmap, copy=False)[1, 2] = (1, 2, 3)
    assert djpt.TensorXf(bitmap).shape == (2, 3, 3)
    assert djpt.TensorXf(bitmap).numpy()[1, 2].tolist() == [1, 2, 3]
    np.testing.assert_array_equal(Bitmap(djpt.TensorXf(bitmap)), bitmap)
    assert np.mean(bitmap, axis=(0, 1)).tolist() == pytest.approx([1 / 6, 2 / 6, 3 / 6])
    assert np.array(Bitmap(np.zeros((2, 3, 1), np.float32))).shape == (2, 3)
    assert djpt.TensorXf(Bitmap(np.zeros((2, 3), np.float32))).shape == (2, 3, 1)
    bitmap.clear()
    assert not np.array(bitmap).any()


def test_copies_are_equal_until_something_changes() -> None:
    bitmap = Bitmap(numbers("RGBA", "Float32"))
    copy = Bitmap(bitmap)
    assert copy == bitmap
    copy.metadata()["name"] = "other"
    assert copy != bitmap
    del copy.metadata()["name"]
    assert copy == bitmap
    np.array(copy, copy=False)[0, 0, 0] = 7
    assert copy != bitmap
    copy = Bitmap(bitmap)
    copy.set_srgb_gamma(True)
    assert copy != bitmap
    assert bitmap != 3


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Bitmap(np.zeros((2, 3, 4, 1))), r"of shape \(2, 3, 4, 1\)"),
        (lambda: Bitmap(np.zeros((2, 3), bool)), "an array or tensor of numbers"),
        (lambda: Bitmap([[1.0, 2.0]]), "an array or tensor of numbers"),
        (lambda: Bitmap(np.zeros((2, 3, 5)), Bitmap.PixelFormat.RGB), "RGB has 3 channels, found 5"),
        (lambda: Bitmap(np.zeros((2, 3, 5)), channel_names=["a"]), "5 different channel names needed"),
        (
            lambda: Bitmap(np.zeros((2, 3, 5))).convert(Bitmap.PixelFormat.RGB),
            "channel 'R' can't be computed from ch0, ch1",
        ),
        (lambda: Bitmap(numbers("RGB", "UInt8")).resample((2, 2)), "only floating point numbers are resampled"),
        (lambda: Bitmap(np.zeros((2, 2))).write(io.BytesIO()), "give the 'format'"),
        (lambda: Bitmap(np.zeros((2, 2))).accumulate(Bitmap(np.zeros((2, 2, 3)))), "convert it first"),
    ],
)
def test_errors_say_what_is_possible(make: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()


# ---- conversion ----------------------------------------------------------------------------

CONVERSIONS = [
    choice
    for number, choice in enumerate(itertools.product(FORMATS, TYPES, FORMATS, TYPES, (False, True), (False, True)))
    if number % 61 == 0
]


@pytest.mark.parametrize("group", range(4))
@pytest.mark.parametrize("transform", ["Empty", "Premultiply", "Unpremultiply"])
@pytest.mark.sparse(3)
def test_conversions_give_mitsubas_numbers(mi: Any, group: int, transform: str) -> None:
    """Whole numbers differ by one where Mitsuba's noise does; its curve of sRGB is exact to 4e-5."""
    for number, (form, kind, wanted, target, before, after) in enumerate(CONVERSIONS[group::4]):
        flags = {"srgb_gamma": before, "premultiplied_alpha": number % 2 == 0}
        ours, theirs = both(mi, numbers(form, kind, number), form, **flags)
        a = ours.convert(Bitmap.PixelFormat[wanted], Type[target], after, Bitmap.AlphaTransform[transform])
        b = theirs.convert(
            getattr(mi.Bitmap.PixelFormat, wanted),
            getattr(mi.Struct.Type, target),
            after,
            getattr(mi.Bitmap.AlphaTransform, transform),
        )
        assert facts(a) == facts(b)
        x, y = np.array(a, np.float64), np.array(b, np.float64)
        limit = np.iinfo(Type[target].dtype).max if Type[target].dtype.kind in "iu" else 1.0
        # What the curve makes of numbers beyond 1 is Mitsuba's own.
        inside = (np.abs(x) < limit) & (y >= 0) & (y < limit) if before or after else np.isfinite(y)
        tolerance = (2e-3 if target == "Float16" else 1e-4 if before or after else 3e-6) * limit
        rounded = 1.0 if limit > 1 else 0.0
        np.testing.assert_allclose(
            x[inside], y[inside], atol=tolerance + rounded, rtol=3e-6, err_msg=f"{form} {wanted}"
        )


def test_bytes_are_rounded_to_nearest_without_noise() -> None:
    half = Bitmap(np.full((9, 9, 1), 0.5, np.float32))
    assert np.unique(half.convert(component_format=Type.UInt8, srgb_gamma=False)).tolist() == [128]
    assert np.unique(half.convert(component_format=Type.UInt8, srgb_gamma=True)).tolist() == [188]
    strange = Bitmap(np.array([[np.nan, np.inf, -np.inf, 2, -1]], np.float32))
    assert np.array(strange.convert(component_format=Type.UInt8)).tolist() == [[0, 255, 0, 255, 0]]


@pytest.mark.parametrize("kind", ["UInt8", "UInt16", "Float16", "Float32", "Float64"])
def test_what_stays_is_copied_bit_for_bit(kind: str) -> None:
    bitmap = Bitmap(numbers("RGBA", kind))
    same = bitmap.convert()
    assert same == bitmap
    assert same is not bitmap
    without = bitmap.convert(Bitmap.PixelFormat.RGB)
    np.testing.assert_array_equal(without, np.array(bitmap)[..., :3])
    target = Bitmap(Bitmap.PixelFormat.RGBA, Type[kind], (7, 5))
    target.set_srgb_gamma(bitmap.srgb_gamma())
    assert bitmap.convert(target) is None
    assert target == bitmap


# ---- sums, flips, sizes ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "places",
    [(), ([2, 1],), ([-2, 3],), ([1, 1], [2, 0], [3, 2]), ([3, 3], [5, 4], [9, 9])],
)
@pytest.mark.parametrize("kind", ["UInt8", "UInt16", "UInt32", "Float16", "Float32", "Float64"])
def test_sums_are_mitsubas(mi: Any, kind: str, places: tuple[Any, ...]) -> None:
    a, b = both(mi, numbers("RGB", kind, 1), "RGB")
    c, d = both(mi, numbers("RGB", kind, 2), "RGB")
    a.accumulate(c, *places)
    b.accumulate(d, *places)
    np.testing.assert_array_equal(a, b)
    a.vflip()
    b.vflip()
    np.testing.assert_array_equal(a, b)


def test_parts_outside_are_left_out() -> None:
    """Also of a rectangle that begins outside, whose size Mitsuba 3.9.1 doesn't reduce."""
    a, b = Bitmap(np.zeros((4, 4), np.float32)), Bitmap(np.ones((4, 4), np.float32))
    a.accumulate(b, [-1, 0], [0, -1], [3, 3])
    assert np.argwhere(np.array(a)).tolist() == [[y, x] for y in (0, 1) for x in (1, 2)]


FILTERS: list[dict[str, Any] | None] = [
    None,
    *({"type": name} for name in ("box", "tent", "gaussian", "mitchell", "catmullrom", "lanczos")),
    {"type": "tent", "radius": 1.7},
]


@pytest.mark.sparse(12)
@pytest.mark.parametrize(
    ("description", "kind"),
    [*((description, "Float32") for description in FILTERS), (None, "Float64"), (None, "Float16")],
    ids=str,
)
@pytest.mark.parametrize("boundary", list(FilterBoundaryCondition))
def test_other_sizes_have_mitsubas_pixels(
    mi: Any, description: dict[str, Any] | None, boundary: FilterBoundaryCondition, kind: str
) -> None:
    theirs = getattr(mi.FilterBoundaryCondition, boundary.name)
    a, b = both(mi, numbers("RGB", kind), "RGB", srgb_gamma=True)
    ours = djpt.load_dict(description) if description else None
    other = mi.load_dict(description) if description else None
    for size, clamp in itertools.product(([7, 5], [3, 2], [11, 4], [16, 13], [1, 1]), ((-np.inf, np.inf), (0.2, 0.7))):
        x = a.resample(size, ours, (boundary, boundary), clamp)
        y = b.resample(size, other, (theirs, theirs), clamp)
        assert facts(x) == facts(y)
        # Mitsuba adds half precision in half precision.
        np.testing.assert_allclose(np.array(x), np.array(y), atol=4e-3 if kind == "Float16" else 2e-6)
    target = Bitmap(Bitmap.PixelFormat.RGB, Type[kind], (4, 4))
    assert a.resample(target, ours) is None
    np.testing.assert_array_equal(target, a.resample((4, 4), ours))


def test_layers_are_mitsubas(mi: Any) -> None:
    layers = {"": "RGBA", "im.": "XYZA", "depth.": "T", "val.": "UV", "test.": "YRM", "multi.": "XB", "lum.": "YA"}
    names = [layer + name for layer, last in layers.items() for name in last]
    pixels = np.random.default_rng(3).random((4, 3, len(names))).astype(np.float32)
    ours, theirs = Bitmap(pixels, channel_names=names).split(), mi.Bitmap(pixels, channel_names=names).split()
    assert [name for name, _ in ours] == [name for name, _ in theirs]
    for (_, a), (_, b) in zip(ours, theirs, strict=True):
        assert a.pixel_format().name == b.pixel_format().name
        order = [field.name for field in b.struct_()]
        assert {f.name: int(f.flags) for f in a.struct_()} == {f.name: int(f.flags) for f in b.struct_()}
        for i, field in enumerate(a.struct_()):
            x, y = (np.array(m).reshape(4, 3, -1) for m in (a, b))
            np.testing.assert_array_equal(x[..., i], y[..., order.index(field.name)])
    single = Bitmap(pixels[..., :3])
    assert single.split()[0][1] is single


def test_a_weight_divides_what_has_none() -> None:
    bitmap = Bitmap(Bitmap.PixelFormat.RGBAW, Type.Float32, (1, 3))
    np.array(bitmap, copy=False)[:, 0] = [(2, 0, 0, 0, 1), (2, 0, 0, 0, 2), (2, 0, 0, 0, 0)]
    shown = np.array(bitmap.convert(Bitmap.PixelFormat.RGBA))
    assert shown[:, 0, 0].tolist() == [2, 1, 2]


# ---- files ---------------------------------------------------------------------------------

WRITTEN = [
    *(("exr", form, kind) for form in FORMATS if form != "RGBAW" for kind in ("Float16", "Float32", "UInt32")),
    *(("png", form, kind) for form in ("Y", "YA", "RGB", "RGBA") for kind in ("UInt8", "UInt16")),
    ("ppm", "RGB", "UInt8"),
    ("pfm", "RGB", "Float32"),
    ("pfm", "Y", "Float32"),
]


@pytest.mark.parametrize(("suffix", "form", "kind"), WRITTEN)
def test_files_go_both_ways(mi: Any, tmp_path: Path, suffix: str, form: str, kind: str) -> None:
    """What either writes, both read alike."""
    paths = [str(tmp_path / f"{name}.{suffix}") for name in ("ours", "theirs")]
    ours, theirs = both(mi, numbers(form, kind), form)
    ours.write(paths[0])
    theirs.write(paths[1])
    for path in paths:
        a, b = Bitmap(path), mi.Bitmap(path)
        assert facts(a) == facts(b)
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(np.array(a).reshape(np.array(ours).shape), ours)


@pytest.mark.parametrize(("suffix", "form"), [("jpg", "RGB"), ("jpeg", "Y"), ("hdr", "RGB")])
def test_lossy_files_are_read_as_mitsuba_reads_them(mi: Any, tmp_path: Path, suffix: str, form: str) -> None:
    kind = "Float32" if suffix == "hdr" else "UInt8"
    path = str(tmp_path / f"a.{suffix}")
    for quality in (-1, 40):
        Bitmap(numbers(form, kind), Bitmap.PixelFormat[form]).write(path, quality=quality)
        a, b = Bitmap(path), mi.Bitmap(path)
        assert facts(a) == facts(b)
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("name", "kind"), [("PNG", "UInt8"), ("JPEG", "UInt8"), ("OpenEXR", "Float32"), ("RGBE", "Float32")]
)
def test_streams_and_their_formats(name: str, kind: str) -> None:
    stream = io.BytesIO()
    bitmap = Bitmap(numbers("RGB", kind))
    bitmap.write(stream, Bitmap.FileFormat[name])
    stream.seek(0)
    assert Bitmap.detect_file_format(stream) is Bitmap.FileFormat[name]
    assert stream.tell() == 0
    back = Bitmap(stream)
    assert list(back.size()) == list(bitmap.size())
    assert back.component_format() is Type[kind]
    assert Bitmap.detect_file_format(io.BytesIO(b"nothing of the kind")) is Bitmap.FileFormat.Unknown


def test_a_file_is_known_by_its_content(tmp_path: Path) -> None:
    bitmap = Bitmap(numbers("RGB", "UInt8"))
    bitmap.write(tmp_path / "a.png")
    (tmp_path / "a.png").rename(tmp_path / "a.jpg")
    np.testing.assert_array_equal(Bitmap(tmp_path / "a.jpg"), bitmap)
    with pytest.raises(FileError, match="there is no such file"):
        Bitmap(tmp_path / "nowhere.png")
    bitmap.write(tmp_path / "b.picture", Bitmap.FileFormat.BMP)
    np.testing.assert_array_equal(Bitmap(tmp_path / "b.picture"), bitmap)


@pytest.mark.parametrize(
    ("name", "pixels", "message"),
    [
        ("a.png", np.zeros((2, 2, 3), np.float32), "png holds numbers of type uint8 or uint16, found float32"),
        ("a.exr", np.zeros((2, 2, 3), np.uint8), "exr holds numbers of type float16 or float32 or uint32, found uint8"),
        ("a.ppm", np.zeros((2, 2, 4), np.uint8), "ppm holds 3 channels, found 4"),
        ("a.gif", np.zeros((2, 2, 3), np.uint8), "unknown format 'gif'; did you mean 'tif'\\?.* exr"),
    ],
)
def test_files_that_cant_hold_a_bitmap(tmp_path: Path, name: str, pixels: np.ndarray, message: str) -> None:
    with pytest.raises(FileError, match=message):
        Bitmap(pixels).write(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_metadata_survive_an_exr_in_both_directions(mi: Any, tmp_path: Path) -> None:
    values = {"text": "value", "whole": 15, "number": 30.5, "vector": [1.0, 2.0, 3.0], "yes": True}
    ours, theirs = both(mi, numbers("RGB", "Float32"), "RGB")
    for bitmap, place in ((ours, djpt.ScalarTransform4f()), (theirs, mi.ScalarTransform4f())):
        for name, value in values.items():
            bitmap.metadata()[name] = value
        bitmap.metadata()["place"] = place.translate([1, 2, 3])
    ours.write(tmp_path / "ours.exr")
    theirs.write(str(tmp_path / "theirs.exr"))
    for path in (tmp_path / "ours.exr", tmp_path / "theirs.exr"):
        read, other = Bitmap(path).metadata(), mi.Bitmap(str(path)).metadata()
        assert {"pixelAspectRatio", "screenWindowWidth", "generatedBy"} <= set(read)
        assert set(read) == set(other.keys()) - {"type"}  # of the file
        assert (read["text"], read["whole"], read["number"], read["yes"]) == ("value", 15, 30.5, "true")
        assert [other[name] for name in ("text", "whole", "number", "yes")] == ["value", 15, 30.5, "true"]
        assert list(read["vector"]) == list(other["vector"]) == [1, 2, 3]
        np.testing.assert_array_equal(read["place"].matrix, np.array(other["place"].matrix))
    with pytest.raises(SceneError, match="metadata 'x': must be a text, a number, three numbers or a 4x4 matrix"):
        ours.metadata()["x"] = [1, 2]


def test_notebooks_show_colours_and_no_layers() -> None:
    shown = Bitmap(numbers("RGBA", "Float32"))._repr_png_()
    assert shown is not None
    expected = np.array(Bitmap(numbers("RGBA", "Float32")).convert(Bitmap.PixelFormat.RGB, Type.UInt8, True))
    found = np.array(Bitmap(io.BytesIO(shown)))
    factor = len(found) // len(expected)
    assert factor > 1, "small images are enlarged"
    np.testing.assert_array_equal(found, expected.repeat(factor, axis=0).repeat(factor, axis=1))
    html = Bitmap(numbers("Y", "UInt8"))._repr_html_()
    assert html is not None
    assert html.startswith('<img src="data:image/png;base64,')
    assert Bitmap(np.zeros((2, 2, 7)))._repr_html_() is None


# ---- where they are used -------------------------------------------------------------------


def test_textures_and_lights_take_bitmaps() -> None:
    pixels = numbers("RGBA", "UInt8")
    texture = djpt.load_dict({"type": "bitmap", "bitmap": Bitmap(pixels)})
    shown = djpt.traverse(texture)["data"].numpy()
    np.testing.assert_allclose(shown, Bitmap(pixels).convert(Bitmap.PixelFormat.RGB, Type.Float32, False), rtol=1e-6)
    raw = djpt.load_dict({"type": "bitmap", "bitmap": Bitmap(pixels), "raw": True})
    np.testing.assert_allclose(djpt.traverse(raw)["data"].numpy(), pixels[..., :3] / np.float32(255), rtol=1e-6)
    xyz = Bitmap(numbers("XYZ", "Float32"), Bitmap.PixelFormat.XYZ)
    seen = djpt.traverse(djpt.load_dict({"type": "bitmap", "bitmap": xyz}))["data"].numpy()
    np.testing.assert_allclose(seen, xyz.convert(Bitmap.PixelFormat.RGB), atol=1e-6)
    light = djpt.load_dict({"type": "envmap", "bitmap": Bitmap(numbers("RGB", "Float32"))})
    np.testing.assert_array_equal(djpt.traverse(light)["data"].numpy()[:, 1:-1], numbers("RGB", "Float32"))


def test_formats_of_textures_are_mitsubas_precisions() -> None:
    bitmap = Bitmap(numbers("RGB", "UInt16"))
    texels = {
        (form, srgb): djpt.traverse(djpt.load_dict({"type": "bitmap", "bitmap": bitmap, "format": form}))[
            "data"
        ].numpy()
        for srgb in (False, True)
        if bitmap.set_srgb_gamma(srgb) is None
        for form in ("auto", "variant", "float16", "fp16", "uint8")
    }
    for srgb in (False, True):
        exact = texels["variant", srgb]
        np.testing.assert_array_equal(texels["auto", srgb], exact)
        np.testing.assert_array_equal(texels["float16", srgb], exact.astype(np.float16))
        np.testing.assert_array_equal(texels["fp16", srgb], texels["float16", srgb])
        bitmap.set_srgb_gamma(srgb)
        stored = bitmap.convert(component_format=Type.UInt8, srgb_gamma=srgb)
        decoded = stored.convert(component_format=Type.Float32, srgb_gamma=False)
        np.testing.assert_allclose(texels["uint8", srgb], decoded, rtol=1e-6)


def test_write_bitmap_creates_the_folder(tmp_path: Path) -> None:
    image = np.full((4, 4, 3), 0.5, np.float32)
    djpt.util.write_bitmap(tmp_path / "results" / "first" / "a.exr", image)
    assert np.array_equal(np.array(Bitmap(str(tmp_path / "results" / "first" / "a.exr"))), image)
    with pytest.raises(djpt.FileError, match="others"):
        djpt.util.write_bitmap(tmp_path / "others" / "a.exr", image, write_async=False)
    assert not (tmp_path / "others").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(djpt.FileError, match="file"):
        djpt.util.write_bitmap(tmp_path / "file" / "a.exr", image)


def test_verbs_make_and_write_bitmaps(tmp_path: Path) -> None:
    image = djpt.TensorXf(numbers("RGBA", "Float32"))
    bitmap = djpt.util.convert_to_bitmap(image)
    assert (bitmap.pixel_format(), bitmap.component_format()) == (Bitmap.PixelFormat.RGB, Type.UInt8)
    assert djpt.util.convert_to_bitmap(image, uint8_srgb=False) == Bitmap(image)
    djpt.util.write_bitmap(str(tmp_path / "a.png"), image)
    djpt.util.write_bitmap(tmp_path / "a.exr", Bitmap(image), write_async=False)
    np.testing.assert_array_equal(Bitmap(tmp_path / "a.png"), bitmap)
    np.testing.assert_array_equal(Bitmap(tmp_path / "a.exr"), Bitmap(image))
    assert djpt.util.cornell_box()["type"] == "scene"


def test_names_of_fields_are_names_of_channels(tmp_path: Path) -> None:
    bitmap = Bitmap(Bitmap.PixelFormat.MultiChannel, Type.Float32, [4, 5], 2)
    bitmap.struct_()[0].name = "mine"
    bitmap.write(tmp_path / "a.exr")
    back = Bitmap(tmp_path / "a.exr")
    assert isinstance(back.struct_(), Struct)
    assert [field.name for field in back.struct_()] == ["ch1", "mine"]
    assert back.struct_()["mine"].flags == Flags.PremultipliedAlpha
