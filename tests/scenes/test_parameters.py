"""`traverse`: Mitsuba's names, edits of every form, and errors that leave things as they were."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.core.transforms import Transform
from djpt.description.parameters import SceneParameters
from djpt.description.plugin import ParamFlags
from djpt.errors import ParameterError
from djpt.jit.types import Array3f, Color3f, Float, TensorXf, UInt32

RED = "red.reflectance.value"
BOX = "large-box.vertex_positions"


@pytest.fixture
def scene() -> Any:
    return djpt.load_dict(djpt.cornell_box())


@pytest.fixture
def params(scene: Any) -> SceneParameters:
    return djpt.traverse(scene)


def numbers(value: Any) -> list[float]:
    return [float(x) for x in np.array(value).ravel()]


# ---------------------------------------------------------------- names


def test_names_are_mitsubas(mi: Any) -> None:
    description = djpt.cornell_box()
    description["point"] = {"type": "point"}
    description["sky"] = {"type": "constant"}
    description["ball"] = {"type": "sphere"}
    two = {"type": "twosided", "a": {"type": "diffuse"}, "b": {"type": "diffuse"}}
    description["panel"] = {"type": "rectangle", "bsdf": two}
    description["unused"] = {"type": "diffuse", "id": "renamed"}
    description["sampler"] = {"type": "independent"}
    description["film"] = {"type": "hdrfilm", "width": 20, "height": 10}
    description["second"] = {
        "type": "perspective",
        "sampler": {"type": "ref", "id": "sampler"},
        "film": {"type": "ref", "id": "film"},
    }
    ours = djpt.traverse(djpt.load_dict(description))
    theirs = mi.traverse(mi.load_dict(djpt.validation.to_mitsuba(description), optimize=False))
    assert list(ours) == [key for key in theirs.keys() if key != "allow_thread_reordering"]  # noqa: SIM118
    assert len(ours) == len(theirs) - 1 > 38

    non_differentiable, discontinuous = int(mi.ParamFlags.NonDifferentiable), int(mi.ParamFlags.Discontinuous)
    for key in ours:
        flags = int(theirs.flags(key))
        if key.startswith(("small-box.vertex_", "large-box.vertex_")) and not key.endswith("positions"):
            # Mitsuba's mark says that AD reaches them; here derivatives are by the places of vertices only.
            flags |= non_differentiable
        camera = key.startswith(("sensor.", "second."))
        if (camera and key.endswith((".x_fov", "_offset_x", "_offset_y", ".to_world"))) or key == "point.position":
            # Cameras and lights can be differentiated here; what they see jumps at edges.
            flags = discontinuous
        assert bool(ours.flags(key).differentiable) == (flags & non_differentiable == 0), key
        assert bool(ours.flags(key) & ParamFlags.Discontinuous) == (flags & discontinuous != 0), key


def test_names_in_a_twosided_of_one(mi: Any) -> None:
    description = {"type": "twosided", "inner": {"type": "diffuse"}}
    assert list(djpt.traverse(djpt.load_dict(description))) == list(mi.traverse(mi.load_dict(description)).keys())


def test_values_are_mitsubas(mi: Any, params: SceneParameters) -> None:
    theirs = mi.traverse(mi.load_dict(mi.cornell_box(), optimize=False))
    for key, value in params.items():
        other = theirs[key]
        if isinstance(value, Transform):
            assert type(value).__name__ == type(other).__name__
            np.testing.assert_allclose(np.array(value.matrix), np.array(other.matrix), atol=2e-7, err_msg=key)
        else:
            np.testing.assert_allclose(np.array(value), np.array(other), atol=5e-7, err_msg=key)


def test_parts_can_be_traversed(scene: Any) -> None:
    assert list(djpt.traverse(scene.sensors()[0]))[:2] == ["near_clip", "far_clip"]
    assert list(djpt.traverse(scene.shapes()[0].emitter().radiance)) == ["value"]
    with pytest.raises(ParameterError, match=r"traverse: expected a plugin that djpt.load_dict made, found dict"):
        djpt.traverse({"type": "scene"})  # type: ignore[arg-type]


def test_a_shared_plugin_appears_under_its_first_path() -> None:
    loaded = djpt.load_dict(
        {
            "type": "scene",
            "a": {"type": "rectangle", "bsdf": {"type": "ref", "id": "late"}},
            "b": {"type": "rectangle", "bsdf": {"type": "ref", "id": "late"}},
            "late": {"type": "diffuse"},
        }
    )
    params = djpt.traverse(loaded)
    assert [key for key in params if "reflectance" in key] == ["a.bsdf.reflectance.value"]
    params["a.bsdf.reflectance.value"] = 0.125
    params.update()
    assert all(numbers(shape.bsdf().reflectance.value) == [0.125] * 3 for shape in loaded.shapes())


# ---------------------------------------------------------------- the mapping


def test_mapping(params: SceneParameters) -> None:
    assert RED in params and "red" not in params and 3 not in params
    assert len(params) == len(list(params)) == len(params.keys()) == len(params.values()) == len(params.items()) == 38
    assert dict(params).keys() == params.keys()
    del params[RED]
    assert RED not in params and len(params) == 37


def test_keep(params: SceneParameters) -> None:
    whole = params.copy()
    params.keep(r".*\.reflectance\.value")
    assert list(params) == ["white.reflectance.value", "green.reflectance.value", RED]
    params.keep(["red", "green"])
    assert list(params) == ["green.reflectance.value", RED]
    params.keep("nothing")
    assert list(params) == [] and repr(params) == "SceneParameters[]"
    assert len(whole) == 38
    whole.keep(None)
    assert RED in whole and "floor.to_world" in whole and "sensor.x_fov" in whole and "sensor.near_clip" not in whole
    with pytest.raises(ParameterError, match=r"keep: str '\(' isn't a regular expression"):
        whole.keep("(")
    with pytest.raises(ParameterError, match="keep: "):
        whole.keep([3])  # type: ignore[list-item]


def test_table(params: SceneParameters) -> None:
    lines = {line.split()[0]: line.split() for line in repr(params).splitlines() if "." in line}
    assert lines[RED] == [RED, "∂", "Array3f", "ConstantTexture"]
    assert lines["floor.to_world"] == ["floor.to_world", "∂,", "D", "AffineTransform4f", "Rectangle"]
    assert len(lines) == 38


# ---------------------------------------------------------------- edits


@pytest.mark.parametrize(
    "value",
    [Color3f(0.25, 0.5, 0.75), [0.25, 0.5, 0.75], (0.25, 0.5, 0.75), np.array([0.25, 0.5, 0.75])],
    ids=["Color3f", "list", "tuple", "numpy"],
)
def test_assigned_colours(scene: Any, params: SceneParameters, value: Any) -> None:
    params[RED] = value
    told = params.update()
    assert numbers(params[RED]) == [0.25, 0.5, 0.75] and type(params[RED]) is Array3f
    assert [keys for _, keys in told] == [{"value"}, {"reflectance"}, {"red"}]
    assert told[-1][0] is scene
    assert params.update() == []


def test_mitsubas_values(mi: Any, params: SceneParameters) -> None:
    params.update({RED: mi.Color3f(0.25, 0.5, 0.75), "sensor.to_world": mi.Transform4f().translate([0, 0, 2])})
    assert numbers(params[RED]) == [0.25, 0.5, 0.75]
    assert params["sensor.to_world"] == T().translate([0, 0, 2])
    params["sensor.film.size"] = mi.ScalarVector2u(32, 16)
    params.update()
    assert params["sensor.film.crop_size"] == (32, 16)


def test_numbers_for_every_type(params: SceneParameters) -> None:
    params.update({RED: 0.5, "sensor.near_clip": 1, "sensor.x_fov": Float(30), "floor.to_world": np.eye(4)})
    assert numbers(params[RED]) == [0.5] * 3
    assert params["sensor.near_clip"] == 1.0 and type(params["sensor.near_clip"]) is float
    assert numbers(params["sensor.x_fov"]) == [30]
    assert params["floor.to_world"] == T()


def test_edits_in_place_are_noticed(params: SceneParameters) -> None:
    before = numbers(params[RED])
    params[RED] *= 0.5
    assert len(params.update()) == 3
    assert numbers(params[RED]) == pytest.approx([x / 2 for x in before])
    value = params[RED]
    value.x = 0.75
    assert len(params.update()) == 3 and numbers(params[RED])[0] == 0.75
    params["sensor.near_clip"] += 0.5
    assert len(params.update()) == 2
    assert params[RED] is params[RED] and params.update() == []


def test_computed_values_can_be_edited_in_place(scene: Any, params: SceneParameters) -> None:
    box = scene.shapes()[-1]
    before = box.to_world.translation()
    positions = params[BOX]
    positions += Float(np.tile([0, 1, 0], 24))
    assert params[BOX] is positions
    assert len(params.update()) == 2
    np.testing.assert_allclose(box.to_world.translation() - before, [0, 1, 0], atol=1e-6)
    params[BOX] -= 1
    params.update()
    np.testing.assert_allclose(box.to_world.translation() - before, [-1, 0, -1], atol=1e-6)


def test_assigning_the_same_is_no_edit(params: SceneParameters) -> None:
    for key in params:
        if "large-box" not in key and "small-box" not in key:
            params[key] = params[key]
    assert params.update() == []


def test_set_dirty(scene: Any, params: SceneParameters) -> None:
    params.set_dirty(RED)
    assert [keys for _, keys in params.update()] == [{"value"}, {"reflectance"}, {"red"}]
    params.update({"sensor.film.size": (8, 4), RED: 0.5})
    told = params.update({"sensor.film.size": (4, 8)})
    assert [keys for _, keys in told] == [{"size"}, {"film"}, {"sensor"}]


def test_assigned_arrays_are_copied(params: SceneParameters) -> None:
    mine = Color3f(0.5)
    array = np.array([0.5, 0.5, 0.5], dtype=np.float32)
    params.update({RED: mine, "green.reflectance.value": array})
    mine += 0.25
    array += 0.25
    assert numbers(params[RED]) == numbers(params["green.reflectance.value"]) == [0.5] * 3


def test_gradients_stay_attached(params: SceneParameters) -> None:
    x = Float(0.5)
    dr.enable_grad(x)
    params.update({RED: Color3f(x, 0.25, x * x)})
    value = params[RED]
    assert dr.grad_enabled(value)
    dr.backward(value.x + value.z)
    assert x.grad[0] == 1 + 2 * 0.5

    leaf = params["green.reflectance.value"]
    dr.enable_grad(leaf)
    params.update()
    dr.backward(dr.sum(params["green.reflectance.value"] * 3))
    assert numbers(leaf.grad) == [3, 3, 3]


def test_optimisers_pattern(params: SceneParameters) -> None:
    from drjit.opt import Adam

    opt = Adam(lr=0.05)
    opt[RED] = params[RED]
    opt["something else"] = Float(1)
    target = Color3f(0.25, 0.5, 0.75)
    for _ in range(100):
        opt[RED] = dr.clip(opt[RED], 0, 1)
        params.update(opt)
        dr.backward(dr.sum(dr.square(params[RED] - target)))
        opt.step()
    np.testing.assert_allclose(numbers(params[RED]), numbers(target), atol=0.02)
    assert not dr.grad_enabled(params["white.reflectance.value"])


def test_edits_compile_no_kernel(params: SceneParameters) -> None:
    edits: list[dict[str, Any]] = [
        {RED: Color3f(0.125, 0.25, 0.75)},
        {RED: [0.3, 0.6, 0.9]},
        {RED: 0.123},
        {"sensor.x_fov": 33.25, "sensor.near_clip": 0.0625, "sensor.to_world": T().translate([0.1, 0.2, 3])},
        {"floor.to_world": T().translate([0.3, -0.9, 0]).rotate([1, 0, 0], -80)},
        {"light.emitter.radiance.value": np.array([5, 6, 7.5])},
    ]
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        for edit in edits:
            params.update(edit)
        params[RED] *= 0.5
        params.update()
    assert [k["hash"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT] == []


def test_update_inside_a_frozen_function(params: SceneParameters) -> None:
    @dr.freeze
    def frame(x: Color3f) -> Color3f:
        params.update({RED: x})
        return params[RED] * 2

    for k in range(3):
        assert numbers(frame(dr.opaque(Color3f, 0.25 + 0.1 * k))) == pytest.approx([0.5 + 0.2 * k] * 3)


# ---------------------------------------------------------------- errors

REFUSED: list[tuple[str, Any, str]] = [
    ("red.reflectance.valu", 0.5, r"^unknown parameter 'red\.reflectance\.valu'; did you mean 'red\.reflectance\.val"),
    ("nothing like it", 0.5, r"^unknown parameter 'nothing like it'"),
    (RED, 1.2, r"^red\.reflectance\.value: must lie in \[0, 1\], found 1\.2$"),
    (RED, [0.5, -1, 0], r"^red\.reflectance\.value: must lie in \[0, 1\], found -1$"),
    (RED, float("nan"), r"^red\.reflectance\.value: must be finite"),
    (RED, Color3f(dr.nan), r"^red\.reflectance\.value: must be finite"),
    (RED, [1, 2], r"^red\.reflectance\.value: must be one or three numbers, found list \[1, 2\]$"),
    (RED, Color3f([0, 1], 0, 0), r"^red\.reflectance\.value: must be one or three numbers"),
    (RED, "red", r"^red\.reflectance\.value: must be numbers, found str 'red'$"),
    (RED, None, r"^red\.reflectance\.value: must be numbers, found None$"),
    ("light.emitter.radiance.value", -1, r"^light\.emitter\.radiance\.value: must be at least 0, found -1$"),
    ("sensor.near_clip", "x", r"^sensor\.near_clip: must be a float, found str 'x'$"),
    ("sensor.film.size", (0, 0), r"^sensor\.film\.size: "),
    ("sensor.film.crop_size", (1000, 1), r"^sensor\.film: .*crop"),
    ("floor.to_world", T().scale([1, 0, 1]), r"^floor\.to_world: must be invertible"),
    ("floor.to_world", np.full((4, 4), np.nan), r"^floor\.to_world: must be finite"),
    ("floor.to_world", None, r"^floor\.to_world: must be a 4x4 matrix, found None$"),
    ("floor.silhouette_sampling_weight", [1, 2], r"^floor\.silhouette_sampling_weight: must be a float, found list"),
    (BOX, [1, 2, 3], r"^large-box\.vertex_positions: "),
    (BOX, np.full(72, np.inf), r"^large-box\.vertex_positions: must be finite"),
    (BOX, np.random.default_rng(0).random(72), r"^large-box\.vertex_positions: .*box"),
    (BOX, TensorXf([1, 2]), r"^large-box\.vertex_positions: "),
    ("large-box.faces", UInt32(0), r"^large-box\.faces: "),
]  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "message"), REFUSED, ids=[f"{key}={value!r:.20}" for key, value, _ in REFUSED]
)
@pytest.mark.sparse(5)
def test_refused(params: SceneParameters, key: str, value: Any, message: str) -> None:
    before = {k: copy.copy(v) for k, v in params.items()}
    with pytest.raises(ParameterError, match=message):
        params[key] = value
        params.update()
    params.update()
    for k, old in before.items():
        new = params[k]
        assert old == new if isinstance(old, (Transform, tuple, float)) else numbers(old) == numbers(new), k


def test_refused_in_place_edits_are_taken_back(params: SceneParameters) -> None:
    before = numbers(params[RED])
    with pytest.raises(ParameterError, match=r"must lie in \[0, 1\]"):
        params[RED] *= 50
    assert numbers(params[RED]) == before
    value = params[RED]
    value += 50
    with pytest.raises(ParameterError, match=r"must lie in \[0, 1\]"):
        params.update()
    assert numbers(params[RED]) == before and params.update() == []


def test_gradients_of_what_has_none_are_refused() -> None:
    params = djpt.traverse(
        djpt.load_dict(
            {
                "type": "scene",
                "camera": {"type": "perspective"},
                "ball": {"type": "sphere", "bsdf": {"type": "dielectric"}},
            }
        )
    )
    x = Float(30)
    dr.enable_grad(x)
    with pytest.raises(ParameterError, match=r"^camera\.near_clip: .*gradients"):
        params["camera.near_clip"] = x
    dr.enable_grad(params["ball.bsdf.eta"])
    with pytest.raises(ParameterError, match=r"^ball\.bsdf\.eta: .*gradients"):
        params.update()


def test_wrong_arguments(params: SceneParameters) -> None:
    for use in (params.flags, params.set_dirty, params.__getitem__, params.__delitem__):
        with pytest.raises(ParameterError, match=r"^unknown parameter 'red'"):
            use("red")
    with pytest.raises(ParameterError, match=r"^unknown parameter 3"):
        params[3]  # type: ignore[index]
    with pytest.raises(KeyError):
        params["red"]
    with pytest.raises(ParameterError, match=r"^update: expected a mapping"):
        params.update([1])  # type: ignore[arg-type]


PARTS: dict[str, tuple[Callable[[djpt.Scene], Any], str, str, Any]] = {
    "emitter": (
        lambda scene: scene.emitters()[0],
        "radiance.value",
        "light.emitter.radiance.value",
        [50.0, 40.0, 30.0],
    ),
    "texture": (
        lambda scene: scene.emitters()[0].radiance,
        "value",
        "light.emitter.radiance.value",
        [50.0, 40.0, 30.0],
    ),
    "bsdf": (lambda scene: scene.shapes()[1].bsdf(), "reflectance.value", "white.reflectance.value", [0.1, 0.2, 0.3]),
    "shape": (lambda scene: scene.shapes()[1], "to_world", "floor.to_world", T().translate([0, -0.8, 0]).scale(0.2)),
}


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.sparse(2)
def test_scenes_follow_edits_of_their_parts(name: str) -> None:
    part, short, long, value = PARTS[name]
    box = djpt.cornell_box()
    box["sensor"]["film"].update(width=8, height=8)
    edited, expected = djpt.load_dict(box), djpt.load_dict(box)
    before = np.array(djpt.render(edited, spp=2))
    for root, key in ((part(edited), short), (expected, long)):
        params = djpt.traverse(root)
        params[key] = value
        params.update()
    image = np.array(djpt.render(edited, spp=2))
    assert not np.array_equal(image, before)
    assert np.array_equal(image, np.array(djpt.render(expected, spp=2)))


def test_derivatives_by_a_part_of_a_scene() -> None:
    scene = djpt.load_dict({"type": "scene", "shape": {"type": "rectangle"}})
    params = djpt.traverse(scene.shapes()[0])
    stretch = djpt.Float(0)
    dr.enable_grad(stretch)
    params["to_world"] = djpt.Transform4f().scale([1 + stretch, 1 + 2 * stretch, 1])
    params.update()
    uv = scene.ray_intersect(djpt.Ray3f([0.1, 0.2, -2], [0, 0, 1])).uv
    dr.forward(stretch)
    assert np.allclose(np.array(dr.grad(uv)).ravel(), [-0.05, -0.2])
