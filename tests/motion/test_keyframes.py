"""Animated transforms: interpolation, bounds, descriptions, parameters, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt import AnimatedTransform4f as A
from djpt.core.transforms import ScalarTransform4f as T
from djpt.errors import ParameterError, SceneError

FIRST = T().translate([1, 2, 3]).rotate([0, 1, 0], 30).scale([1, 2, 1])
LAST = T().translate([4, 5, 6]).rotate([0, 1, 0], 60).scale([2, 1, 2])

XML = """<scene version="3.0.0">
    <animation id="path">
        <transform time="0"><translate x="-1"/></transform>
        <transform time="1.5"><rotate z="1" angle="90"/><translate x="1" y="2" z="3"/></transform>
    </animation>
    <sensor type="perspective">
        <float name="shutter_close" value="1"/>
        <animation name="to_world">
            <transform time="0"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
            <transform time="1"><lookat origin="1,0,5" target="0,0,0" up="0,1,0"/></transform>
        </animation>
    </sensor>
    <shape type="sphere" id="a"><ref id="path" name="to_world"/></shape>
    <shape type="cube" id="b"><ref id="path" name="to_world"/></shape>
    <emitter type="constant"/>
</scene>"""


def test_parts_are_interpolated_each_in_its_way() -> None:
    middle = T().translate([2.5, 3.5, 4.5]).rotate([0, 1, 0], 45).scale([1.5, 1.5, 1.5])
    motion = A([(1.0, LAST), (0.0, FIRST)])
    for time, expected in ((-1, FIRST), (0, FIRST), (0.5, middle), (1, LAST), (2, LAST)):
        assert np.allclose(motion.eval_scalar(time).matrix, expected.matrix, atol=1e-9)
    times = djpt.Float([-1, 0, 0.3, 0.5, 1, 2])
    lanes = np.array(motion.eval(times).matrix)
    for k, time in enumerate([-1, 0, 0.3, 0.5, 1, 2]):
        assert np.allclose(lanes[..., k], motion.eval_scalar(time).matrix, atol=1e-5)


def test_many_keyframes_are_searched() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.random(23))
    motion = A({t: T().translate(rng.random(3)).rotate([0, 0, 1], 300 * rng.random()) for t in times.tolist()})
    asked = rng.random(200) * 1.4 - 0.2
    lanes = np.array(motion.eval(djpt.Float(asked.astype(np.float32))).matrix)
    for k, time in enumerate(asked):
        assert np.allclose(lanes[..., k], motion.eval_scalar(float(np.float32(time))).matrix, atol=1e-4)


def test_boxes_hold_what_turns() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        axis = rng.normal(size=3)
        keys = [T().translate(rng.normal(size=3)).rotate(axis / np.linalg.norm(axis), 170 * rng.random()) for _ in "ab"]
        motion = A({0: keys[0], 1: keys[1].scale(rng.random() + 0.5)})
        low, high = motion.keyframes.box(np.full(3, -1.0), np.ones(3))
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        for time in rng.random(50):
            placed = motion.eval_scalar(time).transform_point(corners)
            assert (placed >= low - 1e-9).all() and (placed <= high + 1e-9).all()


def test_xml_reads_and_writes_animations() -> None:
    from djpt.description.xml.reading import read_string

    for text in (XML, djpt.to_xml(read_string(XML))):
        scene = djpt.load_string(text)
        a, b = scene.shapes()
        assert np.allclose(a.motion.eval_scalar(1.5).translation(), [1, 2, 3]) and a.motion == b.motion
        assert np.allclose(scene.sensors()[0].motion.eval_scalar(0.5).translation(), [0.5, 0, 5])
    # What refers to one animation moves as one.
    assert len(djpt.load_string(XML).geometry.parts) == 2


def test_dicts_share_an_animation_by_reference() -> None:
    ball = {"type": "sphere", "to_world": {"type": "ref", "id": "path"}}
    scene = djpt.load_dict({"type": "scene", "path": A({0: T(), 1: T().translate([1, 0, 0])}), "a": ball, "b": ball})
    assert scene.shapes()[0].motion is scene.shapes()[1].motion


def test_keyframes_are_parameters() -> None:
    scene = djpt.load_string(XML)
    params = djpt.traverse(scene)
    assert params["a.to_world.translation"].shape == (2, 3) and params["a.to_world.rotation"].shape == (2, 4)
    params["a.to_world.translation"] = [-1, 0, 0, 3, 0, 0]
    params.update()
    assert np.allclose(scene.shapes()[0].motion.eval_scalar(0.75).translation(), [1, 0, 0])
    # Another number of keyframes needs all four.
    params["a.to_world.times"] = djpt.TensorXf([0, 1, 2.0], shape=(3,))
    with pytest.raises(ParameterError, match="assign all four"):
        params.update()
    params["a.to_world.times"] = djpt.TensorXf([0, 1, 2.0], shape=(3,))
    params["a.to_world.scale"] = djpt.TensorXf([1.0] * 9, shape=(3, 3))
    params["a.to_world.rotation"] = djpt.TensorXf([0, 0, 0, 1.0] * 3, shape=(3, 4))
    params["a.to_world.translation"] = djpt.TensorXf([1, 0, 0, 3, 0, 0, 7, 0, 0.0], shape=(3, 3))
    params.update()
    assert np.allclose(scene.shapes()[0].motion.eval_scalar(1.5).translation(), [5, 0, 0])


SHEARED = T([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
STRETCHED, MIRRORED = A({0: T(), 1: T().scale([1, 2, 1])}), A({k: T().scale([-1, 1, 1]) for k in (0, 1)})


@pytest.mark.parametrize(
    ("keyframes", "message"),
    [
        ({0: T()}, "at least two keyframes"),
        ([(1, T()), (1, T())], "same time"),
        ({0: T(), 1: SHEARED}, "must not contain shear"),
        ({0: T().scale(1), 1: T().scale(-1)}, "change their sign"),
    ],
)
def test_keyframes_that_cannot_be_interpolated(keyframes: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        A(keyframes)


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ({"type": "sphere", "to_world": STRETCHED}, "scale uniformly"),
        ({"type": "perspective", "to_world": STRETCHED}, "no size"),
        ({"type": "point", "to_world": STRETCHED}, "no size"),
        ({"type": "rectangle", "e": {"type": "area"}, "to_world": STRETCHED}, "emits light"),
        ({"type": "cube", "to_world": MIRRORED}, "must not mirror"),
        ({"type": "sunsky", "to_world": MIRRORED}, "can't be animated"),
        ({"type": "distant", "to_world": STRETCHED}, "no size"),
        ({"type": "distant", "target": {"type": "cube", "to_world": STRETCHED}}, "draws points by area"),
        ({"type": "rectangle", "meter": {"type": "irradiancemeter"}, "to_world": STRETCHED}, "carries a sensor"),
        ({"type": "shapegroup", "a": {"type": "cube", "to_world": STRETCHED}}, "only whole instances move"),
        ({"type": "sphere", "to_world": A({0: T(), 1: T()}), "interior": {"type": "homogeneous"}}, "bounds a medium"),
    ],
)
def test_what_cannot_move_says_so(node: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        djpt.load_dict(node)


@pytest.mark.parametrize("kind", ["point", "perspective"])
def test_what_moves_knows_its_animation_and_all_of_its_places(kind: str) -> None:
    places = {0: T().translate([1, -2, 3]), 1: T().translate([-1, 5, 0]), 2: T().translate([0, 2, 8])}
    moving = djpt.load_dict({"type": kind, "to_world": A(places)})
    assert np.allclose(moving.world_transform_anim().eval_scalar(2).translation(), [0, 2, 8])
    box = moving.bbox()
    assert np.allclose(np.array(box.min), [-1, -2, 0]) and np.allclose(np.array(box.max), [1, 5, 8])
    assert djpt.load_dict({"type": kind}).world_transform_anim() is None


def test_edits_must_leave_what_moves_possible() -> None:
    scene = djpt.load_string(XML)
    params = djpt.traverse(scene)
    params["a.to_world.scale"] = [1, 1, 1, 1, 2, 1]
    with pytest.raises(ParameterError, match="scale uniformly"):
        params.update()
    assert np.allclose(np.array(params["a.to_world.scale"]), 1)
