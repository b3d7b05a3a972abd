"""Textures in scenes: the pixels of Mitsuba, edits and what they cost, ranges and errors."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError
from tests.kit.kernels import kernels
from tests.kit.renders import ours, theirs
from tests.kit.textured_room import FLOOR, TURNED, WALL, bitmap, close, room, texels


def test_textured_scenes_are_mitsubas_pixel_by_pixel() -> None:
    pytest.importorskip("mitsuba")
    floor = bitmap(texels(6, 8, 3), to_uv=T().scale([3, 2, 1]))
    wall = {"type": "checkerboard", "color0": bitmap(texels(5, 3, 1), filter_type="nearest"), "to_uv": T().scale(6)}
    scene = room(floor, wall)
    assert close(ours(scene, 8), theirs(scene, 8)) > 0.98


def test_a_textured_light_shines_as_its_mean() -> None:
    # Mitsuba draws points on textured lights by their brightness: same picture, other noise.
    pytest.importorskip("mitsuba")
    scene = room(0.5)
    scene["lamp"]["emitter"]["radiance"] = bitmap(5 * texels(3, 4, 3))
    np.testing.assert_allclose(ours(scene, 64).mean((0, 1)), theirs(scene, 64).mean((0, 1)), rtol=0.01)


def test_edits_of_texels_show() -> None:
    scene = djpt.load_dict(room(bitmap(texels(6, 8, 3))))
    params = djpt.traverse(scene)
    for size, seed in (((6, 8, 3), 1), ((3, 2, 3), 2), ((16, 9, 3), 3)):
        data = texels(*size, seed=seed)
        params.update({f"{FLOOR}.data": data, f"{FLOOR}.to_uv": TURNED})
        expected = djpt.render(djpt.load_dict(room(bitmap(data, to_uv=TURNED))), spp=2)
        np.testing.assert_allclose(np.array(djpt.render(scene, spp=2)), np.array(expected), atol=1e-6)
        assert params[f"{FLOOR}.data"].shape == size


def test_edits_of_textures_compile_nothing() -> None:
    wall = {"type": "checkerboard", "color0": bitmap(texels(4, 4, 3)), "to_uv": T().scale(6)}
    scene = djpt.load_dict(room(bitmap(texels(6, 8, 3)), wall))
    params = djpt.traverse(scene)

    def edited(seed: int, *size: int) -> set[Any]:
        def action() -> None:
            params.update({
                f"{FLOOR}.data": texels(*size, 3, seed=seed), f"{FLOOR}.to_uv": T().scale([seed, 2, 1]),
                f"{WALL}.to_uv": T().scale([1, seed, 1]), f"{WALL}.color0.data": texels(*size, 3, seed=seed),
            })  # fmt: skip
            dr.eval(djpt.render(scene, spp=2))

        return kernels(action)

    known = edited(1, 6, 8)
    assert edited(2, 6, 8) <= known
    assert edited(3, 12, 5) <= known


def test_many_bitmaps_share_one_trace() -> None:
    def count(n: int) -> int:
        balls = {
            f"ball{i}": {
                "type": "sphere", "radius": 0.1, "center": [0.3 * i - 1, -0.6, 0.2],
                "bsdf": {"type": "diffuse", "reflectance": bitmap(texels(2 + i, 3, 3, seed=i))},
            }
            for i in range(n)
        }  # fmt: skip
        scene = djpt.load_dict(room(0.5, **balls))
        return len(scene.bsdfs.ensemble.groups)

    assert count(5) == count(1)


# ---------------------------------------------------------------- ranges and errors


def test_texels_must_lie_in_the_range_of_their_parameter() -> None:
    bright = texels(3, 3, 3)
    bright[1, 2, 0] = 1.5
    with pytest.raises(SceneError, match=r"'alpha' must lie in \[0, 1\], found 1.5"):
        djpt.load_dict({"type": "roughconductor", "alpha": bitmap(bright)})
    djpt.load_dict({"type": "area", "radiance": bitmap(bright)})
    with pytest.raises(SceneError, match="'radiance' must be at least 0, found -1"):
        djpt.load_dict({"type": "area", "radiance": bitmap(np.full((2, 2, 3), -1.0))})
    params = djpt.traverse(djpt.load_dict({"type": "diffuse", "reflectance": bitmap(texels(3, 3, 3))}))
    before = np.array(params["reflectance.data"])
    with pytest.raises(ParameterError, match=r"reflectance.data: must lie in \[0, 1\], found 1.5"):
        params["reflectance.data"] = bright
    np.testing.assert_array_equal(np.array(params["reflectance.data"]), before)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("data", np.full((3, 3, 3), np.nan), "must be finite, found nan in row 0, column 0"),
        ("data", np.zeros((3, 3, 1)), "must keep its 3 channels, found 1"),
        ("data", np.zeros((3, 3, 2)), r"must have the shape .* found \(3, 3, 2\)"),
        ("data", np.zeros((0, 3, 3)), r"must have the shape .* found \(0, 3, 3\)"),
        ("data", "red", "must be an array of numbers, found str 'red'"),
        ("to_uv", np.eye(2), "must be a 3x3 or 4x4 matrix"),
        ("to_uv", np.ones((3, 3)), "must be affine"),
    ],
)
def test_wrong_edits(name: str, value: Any, message: str) -> None:
    params = djpt.traverse(djpt.load_dict(bitmap(texels(3, 3, 3))))
    with pytest.raises(ParameterError, match=message):
        params[name] = value


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"to_uv": [1, 2]}, "'to_uv' must be a 3x3 or 4x4 matrix"),
        ({"filter_type": "cubic"}, "'filter_type' can't be 'cubic'; possible: bilinear, nearest"),
        ({"wrap_mode": "repeated"}, "'wrap_mode' can't be 'repeated'; did you mean 'repeat'"),
        ({"format": "fp8"}, "'format' can't be 'fp8'; possible: auto, float16, fp16, uint8, variant"),
        ({"wrapmode": "repeat"}, "unknown key 'wrapmode' .* did you mean 'wrap_mode'"),
        ({"data": np.zeros((2, 2, 4))}, r"'data' must have the shape .* found \(2, 2, 4\)"),
        ({"data": np.zeros((2, 2), np.uint8)}, "'data' holds linear numbers, found bytes"),
        ({"data": [[1, 2], [3]]}, "'data' must be an array of numbers"),
        ({"data": [[1, np.inf]]}, "'data' must be finite, found inf in row 0, column 1"),
    ],
)
def test_wrong_keys(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict({"type": "bitmap", "data": texels(2, 2, 3), **keys})


def test_half_precision_rounds_texels() -> None:
    data = texels(3, 3, 3)
    texture = djpt.load_dict({"type": "bitmap", "data": data, "format": "fp16"})
    np.testing.assert_array_equal(np.array(texture.data), data.astype(np.float16).astype(np.float32))
    with pytest.raises(SceneError, match="must be finite, found inf"):
        djpt.load_dict({"type": "bitmap", "data": data * 1e6, "format": "fp16"})
