"""Transforms: the same matrices as Mitsuba's, exact inverses, and errors instead of NaN."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import djpt
from djpt.core.transforms import ScalarTransform4f, as_transform
from djpt.core.transforms.lanes import Transform4f
from djpt.errors import AmbiguityError, SceneError
from djpt.jit.types import Float, Matrix4f, Point3f, Vector3f

T = ScalarTransform4f
UNIT = [2 / 7, 3 / 7, 6 / 7]


BUILDERS = {
    "identity": lambda t: t(),
    "translate": lambda t: t().translate([1, -2, 3.5]),
    "scale": lambda t: t().scale([1, -2, 3.5]),
    "scale by a number": lambda t: t().scale(2),
    "rotate": lambda t: t().rotate(UNIT, 37),
    "rotate backwards": lambda t: t().rotate(axis=[0, 0, 1], angle=-90),
    "look_at": lambda t: t().look_at(origin=[1, 2, 3], target=[-3, 0.5, 1], up=[0, 1, 0.1]),
    "chain": lambda t: t().translate([0, 0.99, 0.01]).rotate([1, 0, 0], 90).scale([0.23, 0.19, 0.19]),
    "product": lambda t: t().rotate(UNIT, 20) @ t().translate([1, 2, 3]),
    "without an instance": lambda t: t.translate([1, 2, 3]).scale(2),
    "rotate about a long axis": lambda t: t().rotate([0.5, -1, 2], 37),
    "orthographic": lambda t: t().orthographic(0.5, 3),
    "inverse": lambda t: t().translate([1, 2, 3]).rotate(UNIT, 20).scale([1, 2, 3]).inverse(),
}


@pytest.mark.filterwarnings("ignore:rotate")
@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS.keys())
def test_matrices_are_mitsubas(mi: Any, build: Any) -> None:
    ours, theirs = build(T), build(mi.ScalarTransform4f)
    np.testing.assert_allclose(ours.matrix, np.array(theirs.matrix), atol=1e-6)
    p = np.array([0.3, -0.7, 1.9])
    np.testing.assert_allclose(ours @ p, np.array(theirs @ mi.ScalarPoint3f(p)), atol=2e-6)
    np.testing.assert_allclose(ours.transform_point(p), np.array(theirs @ mi.ScalarPoint3f(p)), atol=2e-6)
    np.testing.assert_allclose(ours.transform_vector(p), np.array(theirs @ mi.ScalarVector3f(p)), atol=2e-6)
    np.testing.assert_allclose(ours.apply_vector(p), ours.transform_vector(p))
    # Mitsuba takes the matrix for its own inverse transpose, as if the axis had unit length.
    if build is not BUILDERS["rotate about a long axis"]:
        np.testing.assert_allclose(ours.transform_normal(p), np.array(theirs @ mi.ScalarNormal3f(p)), atol=2e-6)
        np.testing.assert_allclose(ours.inverse_transpose, np.array(theirs.inverse_transpose), atol=2e-6)
    np.testing.assert_allclose(ours.translation(), np.array(theirs.translation()), atol=1e-6)
    assert ours.has_scale() == theirs.has_scale()


def test_points_of_every_form() -> None:
    t = T().translate([1, 2, 3]).rotate([0, 0, 1], 90)
    np.testing.assert_allclose(np.array(t @ [1, 0, 0]), [1, 3, 3])
    np.testing.assert_allclose(t @ np.array([[1, 0, 0], [0, 1, 0]]), [[1, 3, 3], [0, 2, 3]], atol=1e-15)
    moved = t.transform_point(Point3f([1, 0], [0, 1], 0))
    np.testing.assert_allclose(np.array(moved), [[1, 0], [3, 2], [3, 3]], atol=1e-6)
    turned = t.transform_vector(Vector3f(1, 0, 0))
    np.testing.assert_allclose(np.array(turned)[:, 0], [0, 1, 0], atol=1e-6)
    assert list(t.transform_affine([0, 0, 0])) == [1, 2, 3]
    assert type(t @ [0, 0, 0]) is djpt.ScalarPoint3f and (t @ (0, 0, 0)).z == 3


def test_an_array_that_may_be_a_point_or_a_vector_is_refused() -> None:
    for t in (T().translate([1, 0, 0]), T().scale([1, 2, 1])):
        for x in (Point3f(1, 0, 0), djpt.ScalarVector3f(1, 0, 0)):
            for apply in (t.__matmul__, t.transform_affine):
                with pytest.raises(
                    AmbiguityError, match=r"T\.transform_point\(x\), T\.transform_vector\(x\) or T\.tran"
                ):
                    apply(x)
    for t in (T(), T().rotate(UNIT, 30).scale(2), T().scale([1, -1, 1])):
        x = djpt.ScalarVector3f(1, 2, 3)
        np.testing.assert_allclose(np.array(t @ x), np.array(t @ [1, 2, 3]), rtol=1e-6)
        assert type(t @ x) is type(x)


def test_vectors_of_every_form(mi: Any) -> None:
    for v in (
        [1, 2, 3],
        (1.0, 2, 3),
        np.arange(1, 4),
        Vector3f(1, 2, 3),
        mi.ScalarVector3f(1, 2, 3),
        mi.Point3f(1, 2, 3),
    ):
        assert T().translate(v).translation().tolist() == [1, 2, 3]
    assert T().scale(Float(2)) == T().scale([2, 2, 2])
    with pytest.warns(UserWarning, match=r"rotate: the axis has the length 5, so Mitsuba's matrix also scales"):
        T().rotate([0, 5, 0], 90)


def test_accepted_forms(mi: Any) -> None:
    expected = T().translate([1, 2, 3]).scale(2)
    matrix = expected.matrix
    theirs = mi.ScalarTransform4f().translate([1, 2, 3]).scale(2)
    forms = [
        expected,
        matrix,
        matrix.astype(np.float32),
        matrix.tolist(),
        Matrix4f(matrix),
        theirs,
        mi.Transform4f(theirs),
    ]
    for form in forms:
        assert as_transform(form) == expected
    assert as_transform(Transform4f(expected)) == expected
    assert expected @ T(theirs) == expected @ expected


def test_immutable_and_comparable() -> None:
    source = np.eye(4)
    t = T(source)
    source[0, 3] = 5
    assert t == T() and t != T().scale(2) and t != 3
    with pytest.raises(ValueError):
        t.matrix[0, 0] = 2
    with pytest.raises(AttributeError):
        t.matrix = source  # type: ignore[misc]
    with pytest.raises(TypeError):
        hash(t)
    assert eval(repr(t), {"ScalarTransform4f": T}) == t


NAN, INF = math.nan, math.inf
REFUSED = {
    "nan": (lambda: T().translate([NAN, 0, 0]), r"translate: must be finite .*nan"),
    "inf": (lambda: T().scale(INF), r"scale: must be finite"),
    "too large": (lambda: T().scale(1e39), r"finite in single precision"),
    "nan angle": (lambda: T().rotate([0, 1, 0], NAN), r"rotate: must be finite"),
    "zero axis": (lambda: T().rotate([0, 0, 0], 5), r"rotate: the axis has length 0"),
    "two numbers": (lambda: T().translate([1, 2]), r"translate: must be one or three numbers, found list \[1, 2\]"),
    "ragged": (lambda: T().translate([1, [2]]), r"translate: must be numbers"),
    "string": (lambda: T().translate("abc"), r"translate: must be numbers, found str 'abc'"),
    "None": (lambda: T().translate(None), r"translate: must be numbers, found None"),
    "string angle": (lambda: T().rotate([0, 1, 0], "90"), r"rotate: must be a float, found str '90'"),
    "two factors": (lambda: T().scale([1, 2]), r"scale: must be one or three numbers"),
    "nowhere to look": (lambda: T().look_at([1, 1, 1], [1, 1, 1], [0, 1, 0]), r"look_at: origin and target"),
    "up along the view": (lambda: T().look_at([0, 0, 0], [0, 2, 0], [0, 1, 0]), r"look_at: up = .* parallel"),
    "no up": (lambda: T().look_at([0, 0, 0], [0, 0, 1], [0, 0, 0]), r"look_at: up = .* zero"),
    "3x3": (lambda: T(np.eye(3)), r"must be a 4x4 matrix, found .* of shape \(3, 3\)"),
    "projective": (lambda: T(np.ones((4, 4))), r"must be affine: the last row"),
    "nan matrix": (lambda: as_transform(np.full((4, 4), NAN)), r"must be finite"),
    "singular": (lambda: as_transform(T().scale([1, 1, 0])), r"must be invertible, found a singular matrix"),
    "nearly singular": (lambda: as_transform(T().rotate(UNIT, 9).scale([1, 1, 1]) @ _flat()), r"must be invertible"),
    "object": (lambda: as_transform(object()), r"must be numbers, found object"),
    "no inverse": (lambda: T().scale(0).inverse(), r"singular"),
    "point": (lambda: T() @ [1, 2], r"points have three coordinates"),
}


def _flat() -> ScalarTransform4f:
    matrix = np.eye(4)
    matrix[:3, 2] = [1, 1, 1e-9]
    return T(matrix)


@pytest.mark.parametrize(("build", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_refused(build: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        build()


def test_gradients_are_not_lost_in_silence() -> None:
    import drjit as dr

    x = Float(1)
    dr.enable_grad(x)
    with pytest.raises(SceneError, match="gradients"):
        T().scale(x)


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_small_and_large_shapes_are_not_singular(size: float) -> None:
    t = T().rotate(UNIT, 30).scale([size, 2 * size, 1000 * size])
    assert not t.is_singular()
    np.testing.assert_allclose((t @ t.inverse()).matrix, np.eye(4), atol=1e-9)


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    st.floats(-720, 720),
)
def test_rotations_and_translations_are_rigid(v: list[float], axis: list[float], angle: float) -> None:
    axis = list(np.array(axis) / np.linalg.norm(axis))
    t = T().translate(v).rotate(axis, angle)
    linear = t.matrix[:3, :3]
    np.testing.assert_allclose(linear @ linear.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(linear) == pytest.approx(1) and not t.has_scale()
    np.testing.assert_allclose((t.inverse() @ t).matrix, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(t.transform_vector(np.array(axis)), axis, atol=1e-12)
