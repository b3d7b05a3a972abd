"""Meshes' parameters under the names of Mitsuba 3.10: tensors over the same numbers."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import ParameterError
from djpt.jit.types import Float, Point3f, TensorXf

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]], np.float32)
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.uint32)


def mesh() -> djpt.Mesh:
    return djpt.Mesh(
        "sheet", positions=CORNERS, faces=FACES, normals=np.tile([0, 0, 1], (4, 1)), texcoords=CORNERS[:, :2]
    )


def test_the_newer_names_are_tensors_of_the_same_numbers() -> None:
    params = djpt.traverse(mesh())
    for newer, older, columns in (
        ("positions", "vertex_positions", 3),
        ("normals", "vertex_normals", 3),
        ("texcoords", "vertex_texcoords", 2),
    ):
        assert newer in params and newer not in list(params)
        assert params[newer].shape == (4, columns)
        assert np.array_equal(np.array(params[newer]).ravel(), np.array(params[older]))
        assert params.flags(newer) == params.flags(older)


def test_edits_by_either_name_are_the_same() -> None:
    by_rows, flat = djpt.traverse(mesh()), djpt.traverse(mesh())
    by_rows["positions"] += TensorXf(np.array([[0, 0, 0.5]], np.float32))
    flat["vertex_positions"] = (CORNERS + np.float32([0, 0, 0.5])).ravel()
    for params in (by_rows, flat):
        ((_, changed),) = params.update()
        assert changed == {"vertex_positions"}
    assert np.array_equal(np.array(by_rows["vertex_positions"]), np.array(flat["vertex_positions"]))
    assert np.array_equal(np.array(by_rows["positions"])[:, 2], CORNERS[:, 2] + 0.5)


def test_edits_in_place_are_noticed() -> None:
    params = djpt.traverse(mesh())
    rows = params["positions"]
    rows *= 2
    params.update()
    assert np.array_equal(np.array(params["vertex_positions"]), 2 * CORNERS.ravel())


def test_points_and_back() -> None:
    """The idiom of Mitsuba's tutorial on the pose of an object."""
    params = djpt.traverse(mesh())
    points = Point3f(params["positions"], flip_axes=True)
    params["positions"] = TensorXf(djpt.Transform4f().translate([1, 2, 3]).transform_point(points), flip_axes=True)
    params.update()
    assert np.allclose(np.array(params["positions"]), CORNERS + np.float32([1, 2, 3]))


def test_a_mesh_is_resized() -> None:
    params = djpt.traverse(mesh())
    params["faces"] = djpt.TensorXu(FACES[:1])
    params["positions"] = TensorXf(CORNERS[:3])
    with pytest.warns(UserWarning, match="vertex_texcoords: the size"):
        params.update()
    assert params["positions"].shape == params["normals"].shape == (3, 3)


def scene() -> djpt.SceneParameters:
    return djpt.traverse(djpt.load_dict({"type": "scene", "sheet": mesh(), "sun": {"type": "constant"}}))


def test_gradients_arrive_at_the_tensor() -> None:
    params = scene()
    dr.enable_grad(params["sheet.positions"])
    params.update()
    assert dr.grad_enabled(params["sheet.vertex_positions"])
    dr.backward(dr.sum(dr.square(params["sheet.vertex_positions"])))
    assert np.allclose(np.array(dr.grad(params["sheet.positions"])), 2 * CORNERS)


def test_optimisers_and_patterns_take_them() -> None:
    params = scene()
    params.keep(["sheet.positions"])
    assert list(params) == ["sheet.vertex_positions"]
    params.update({"sheet.positions": TensorXf(CORNERS + 1), "another": Float(1)})
    assert np.array_equal(np.array(params["sheet.positions"]), CORNERS + 1)
    del params["sheet.positions"]
    assert len(params) == 0 and "sheet.positions" not in params


@pytest.mark.parametrize("value", [np.full((4, 3), np.nan), CORNERS[:3], 1.0])
def test_what_does_not_fit_is_refused(value: object) -> None:
    params = scene()
    with pytest.raises(ParameterError, match=r"sheet.*(positions|faces|index)"):
        params["sheet.positions"] = value
        params.update()
    assert np.array_equal(np.array(params["sheet.positions"]), CORNERS)


def test_they_are_names_of_meshes_only() -> None:
    params = djpt.traverse(djpt.load_dict(djpt.cornell_box()))
    assert "light.positions" not in params
    with pytest.raises(ParameterError, match=r"unknown parameter 'light\.positions'"):
        params["light.positions"]
