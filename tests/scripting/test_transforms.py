"""Transforms of scripts: the same calls as Mitsuba's, with the same results."""

from __future__ import annotations

import inspect
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.errors import AmbiguityError, ParameterError, SceneError

UNIT = [2 / 7, 3 / 7, 6 / 7]

SPATIAL = {
    "identity": lambda m, t: t(),
    "translate": lambda m, t: t().translate([1, -2, 3.5]),
    "translate by a number": lambda m, t: t().translate(-0.5),
    "translate by an array": lambda m, t: t().translate(m.ScalarPoint3f(1, -2, 3.5)),
    "scale": lambda m, t: t().scale([1, -2, 3.5]),
    "scale by a number": lambda m, t: t().scale(2),
    "rotate": lambda m, t: t().rotate(UNIT, 37),
    "rotate by keywords": lambda m, t: t().rotate(angle=-90, axis=[0, 0, 1]),
    "look_at": lambda m, t: t().look_at(origin=[1, 2, 3], target=[-3, 0.5, 1], up=[0, 1, 0.1]),
    "look_at with a number": lambda m, t: t().look_at(origin=[1, 2, 3], target=0, up=[0, 1, 0]),
    "orthographic": lambda m, t: t().orthographic(0.5, 3),
    "orthographic by keywords": lambda m, t: t().orthographic(far=3, near=1),
    "chain": lambda m, t: t().translate([0, 0.99, 0.01]).rotate([1, 0, 0], 90).scale([0.23, 0.19, 0.19]),
    "product": lambda m, t: t().rotate(UNIT, 20) @ t().translate([1, 2, 3]) @ t().scale(3),
    "without an instance": lambda m, t: t.translate([1, 2, 3]).scale([1, 2, 3]),
    "inverse": lambda m, t: t().translate([1, 2, 3]).rotate(UNIT, 20).scale([1, 2, 3]).inverse(),
    "rows": lambda m, t: t([[1, 0.5, 0, 1], [0, 2, 0, 2], [0.25, 0, 1, 3], [0, 0, 0, 1]]),
    "numpy": lambda m, t: t(np.diag([1.0, 2, 3, 1])),
    "copy": lambda m, t: t(t().rotate(UNIT, 37)),
    "updated": lambda m, t: t().translate([1, 2, 3]).update(),
}
LANES = {
    "translations": lambda m, t: t().translate([m.Float(1, 2), 0, 3]),
    "scales": lambda m, t: t().scale(m.Float(1, 2)),
    "rotations": lambda m, t: t().rotate(UNIT, m.Float(10, 20)),
    "views": lambda m, t: t().look_at(m.Point3f([1, 2], 2, 3), [0, 0, 0], [0, 1, 0]),
    "frames": lambda m, t: t().to_frame(m.Frame3f(m.Vector3f(*UNIT))),
    "frames back": lambda m, t: t.from_frame(m.Frame3f(m.Vector3f(*UNIT))).translate([1, 2, 3]),
    "matrix": lambda m, t: t(m.Matrix4f([[1, 0.5, 0, 1], [0, 2, 0, 2], [0.25, 0, 1, 3], [0, 0, 0, 1]])),
    "matrices of numpy": lambda m, t: t(np.stack([np.eye(4), np.diag([1.0, 2, 3, 1])], axis=-1)),
    "host": lambda m, t: (
        t(m.ScalarTransform4f().translate([1, 2, 3]).rotate(UNIT, 30)) if "Affine" in t.__name__ else t()
    ),
    "host on the right": lambda m, t: t().scale(2) @ getattr(m, "Scalar" + t.__name__)().translate([1, 2, 3]),
}
PERSPECTIVE = {
    "perspective": lambda m, t: t().perspective(40, 0.5, 20),
    "perspective by keywords": lambda m, t: t.perspective(fov=90, near=1, far=3).rotate(UNIT, 20),
    "any last row": lambda m, t: t([[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0.1, 0, 0, 2]]),
    "inverse perspective": lambda m, t: t().perspective(40, 0.5, 20).inverse(),
}
PLANAR = {
    "identity": lambda m, t: t(),
    "translate": lambda m, t: t().translate([1, -2]),
    "translate by a number": lambda m, t: t().translate(-0.5),
    "scale": lambda m, t: t().scale([1, -2]),
    "rotate": lambda m, t: t().rotate(30),
    "chain": lambda m, t: t.rotate(angle=30).translate([1, 2]).scale(3),
    "inverse": lambda m, t: t().translate([1, 2]).rotate(20).scale([1, 2]).inverse(),
}

CASES = [
    (name, build, what)
    for names, builders in (
        ("AffineTransform4f ProjectiveTransform4f", SPATIAL | LANES),
        ("ProjectiveTransform4f", PERSPECTIVE),
        (
            "AffineTransform4d ProjectiveTransform4d ScalarTransform4f ScalarTransform4d ScalarProjectiveTransform4f",
            SPATIAL,
        ),
        ("ScalarProjectiveTransform4d ProjectiveTransform4d", PERSPECTIVE),
        ("Transform3f ProjectiveTransform3d ScalarTransform3f ScalarProjectiveTransform3f", PLANAR),
    )
    for name in names.split()
    for what, build in builders.items()
]


def numbers(value: Any) -> np.ndarray:
    """An array's numbers, without the axis of a single lane."""
    if dr.is_matrix_v(value) and not dr.is_jit_v(value):  # NumPy misreads small matrices in double precision
        value = [[value[i, j] for j in range(len(value))] for i in range(len(value))]
    found = np.array(value, np.float64)
    return found[..., 0] if found.ndim and found.shape[-1] == 1 else found


def assert_same(ours: Any, theirs: Any) -> None:
    np.testing.assert_allclose(numbers(ours), numbers(theirs), rtol=2e-6, atol=3e-6)


@pytest.mark.sparse(40)
@pytest.mark.parametrize(("name", "build", "what"), CASES, ids=[f"{name}-{what}" for name, _, what in CASES])
def test_transforms_are_mitsubas(mi: Any, name: str, build: Any, what: str) -> None:
    ours, theirs = build(djpt, getattr(djpt, name)), build(mi, getattr(mi, name))
    assert_same(ours.matrix, theirs.matrix)
    assert_same(ours.inverse_transpose, theirs.inverse_transpose)
    assert_same(ours.translation(), theirs.translation())
    assert_same(ours.has_scale(), theirs.has_scale())
    assert_same(ours.inverse().matrix, theirs.inverse().matrix)
    x = [0.3, -0.7, 1.9][: ours.size - 1]
    prefix = "Scalar" if name.startswith("Scalar") else ""
    point, vector, normal = (
        getattr(mi, f"{prefix}{kind}{len(x)}{name[-1]}", None) for kind in ("Point", "Vector", "Normal")
    )
    assert_same(ours @ x, theirs @ x)
    assert_same(ours.transform_point(x), theirs @ point(x))
    assert_same(ours.transform_point(np.array(x)), theirs @ point(x))
    assert_same(ours.transform_vector(x), theirs @ vector(x))
    if normal is not None:
        assert_same(ours.transform_normal(x), theirs @ normal(x))
    if "Affine" in type(theirs).__name__ and ours.size == 4:
        assert_same(ours.extract().matrix, theirs.extract().matrix)
    assert ours == type(ours)(ours) and ours != ours @ type(ours)().scale(2)


@pytest.mark.parametrize("name", ["AffineTransform4f", "ProjectiveTransform4f", "Transform3f", "ScalarTransform4f"])
def test_names_are_mitsubas(mi: Any, name: str) -> None:
    theirs = {n for n in dir(getattr(mi, name)) if not n.startswith("_")}
    # What Mitsuba's `extract` of the plane returns it can't convert.
    missing = {"Transform3f": {"extract"}, "ScalarTransform4f": {"DRJIT_STRUCT"}}
    assert theirs - set(dir(getattr(djpt, name))) == missing.get(name, set())
    if not name.startswith("Scalar"):
        assert repr(getattr(djpt, name)()) == repr(getattr(mi, name)())


def test_assigning_on_the_host_leaves_plugins_alone() -> None:
    transform = djpt.ScalarTransform4f().translate([1, 2, 3])
    shape = djpt.load_dict({"type": "sphere", "to_world": transform})
    transform.assign(djpt.ScalarTransform4f().scale(2))
    assert transform == djpt.ScalarTransform4f().scale(2)
    assert shape.to_world == djpt.ScalarTransform4f().translate([1, 2, 3])


def test_lanes_of_points(mi: Any) -> None:
    def moved(m: Any, apply: str) -> Any:
        t = m.Transform4f().translate([m.Float(1, 2), 0, 0]).rotate([0, 0, 1], 30)
        x = [m.Float(1, 2), 2, 3]
        return getattr(t, f"transform_{apply}")(x) if m is djpt else t @ getattr(m, f"{apply.title()}3f")(x)

    for apply in ("point", "vector", "normal"):
        assert_same(moved(djpt, apply), moved(mi, apply))


def test_arrays_are_refused_unless_points_and_vectors_move_alike() -> None:
    t, x = djpt.Transform4f(), djpt.Vector3f(1, 2, 3)
    ambiguous = [
        t.translate([1, 0, 0]),
        t.scale([1, 2, 1]),
        t.look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]),
        djpt.ProjectiveTransform4f.perspective(40, 1, 2),
        djpt.Transform4f(dr.opaque(djpt.Matrix4f, 1)),
        t.translate([1, 0, 0]) @ t.rotate(UNIT, 30),
        djpt.Transform4f(djpt.ScalarTransform4f().translate([1, 0, 0])),
        dr.gather(djpt.Transform4f, t.translate([1, 0, 0]), djpt.UInt32(0)),
        dr.select(djpt.Bool(True, False), t, t.translate([1, 0, 0])),
    ]
    for refused in ambiguous:
        for apply in (refused.__matmul__, refused.transform_affine):
            with pytest.raises(
                AmbiguityError, match=r"T\.transform_point\(x\), T\.transform_vector\(x\) or T\.transform_normal"
            ):
                apply(x)
    turned = t.rotate(UNIT, djpt.Float(10, 20)).scale(djpt.Float(2))
    alike = [t, turned, turned @ turned.inverse(), t.scale([2, -2, 2]), djpt.Transform4f(np.diag([1.0, -1, 1, 1]))]
    for accepted in alike:
        assert_same(accepted @ x, accepted.transform_point([1, 2, 3]))
        assert_same(accepted @ x, accepted.transform_vector([1, 2, 3]))


def test_a_changed_transform_is_ambiguous() -> None:
    t, x = djpt.Transform4f(), djpt.Vector3f(1, 2, 3)
    t @ x
    t.matrix = djpt.Matrix4f([[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    with pytest.raises(AmbiguityError):
        t @ x
    turned = djpt.Transform4f().rotate(UNIT, dr.opaque(djpt.Float, 30))
    turned @ x
    turned.matrix[0, 3] = djpt.Float(5)
    with pytest.raises(AmbiguityError):
        turned @ x
    assert t.update() is t
    assert_same(t.inverse().matrix, djpt.Transform4f().translate([-5, 0, 0]).matrix)
    other = djpt.Transform4f()
    other.assign(djpt.ScalarTransform4f().translate([5, 0, 0]))
    assert other == t
    other = djpt.Transform4f()
    other[djpt.Bool(True, False)] = t
    assert_same(other.transform_point([0, 0, 0]).x, [5, 0])
    with pytest.raises(AmbiguityError):
        other @ x


def test_rays(mi: Any) -> None:
    def moved(m: Any, kind: str) -> Any:
        ray = dr.zeros(m.Ray3f)
        ray.o, ray.d, ray.maxt = m.Point3f(1, 2, 3), m.Vector3f(0, 0.6, 0.8), m.Float(7)
        return getattr(m, kind)().translate([1, 0, 0]).rotate(UNIT, 30).scale([1, 2, 3]) @ ray

    theirs = moved(mi, "Transform4f")
    for kind in ("Transform4f", "ScalarTransform4f"):
        ours = moved(djpt, kind)
        for name in ("o", "d", "maxt"):
            assert_same(getattr(ours, name), getattr(theirs, name))


def test_gradients(mi: Any) -> None:
    """By the angle and the offset, through a chain and its inverse, as Mitsuba's."""

    def gradients(m: Any) -> list[float]:
        angle, offset = m.Float(30), m.Float(0.5)
        dr.enable_grad(angle, offset)
        t = m.Transform4f().translate([offset, 0, 0]).rotate([0, 1, 0], angle).scale([offset, 1, 2])
        x = [m.Float(1, 2, 3), m.Float(0, 1, 5), m.Float(-1, 2, 2)]
        point = t.transform_point(x) if m is djpt else t @ m.Point3f(x)
        normal = t.transform_normal(x) if m is djpt else t @ m.Normal3f(x)
        back = t.inverse().transform_point(x) if m is djpt else t.inverse() @ m.Point3f(x)
        dr.backward(dr.sum(point * normal + back, axis=None))
        return [angle.grad[0], offset.grad[0]]

    found = gradients(djpt)
    assert_same(found, gradients(mi))
    assert all(found)


def test_records_of_dr_jit() -> None:
    t = djpt.Transform4f().scale(djpt.Float(1, 2, 3))
    assert dr.width(t) == 3 and dr.width(dr.zeros(djpt.Transform4f, 4)) == 4
    assert_same(dr.gather(djpt.Transform4f, t, djpt.UInt32(2)).matrix[0, 0], 3)
    assert_same(dr.select(djpt.Bool(True, False, True), t, djpt.Transform4f()).matrix[1, 1], [1, 1, 3])
    x = djpt.Float(1)
    dr.enable_grad(x)
    assert dr.grad_enabled(djpt.Transform4f().translate([x, 0, 0]))


def test_mixed_kinds() -> None:
    lanes, host = djpt.Transform4f().translate([1, 2, 3]), djpt.ScalarTransform4f().scale(2)
    projective = djpt.ProjectiveTransform4f.perspective(40, 1, 2)
    assert type(lanes @ host) is type(host @ lanes) is djpt.Transform4f
    assert host @ lanes == djpt.Transform4f().scale(2).translate([1, 2, 3]) and djpt.Transform4f(host) == host
    assert type(lanes @ projective) is type(projective @ host) is djpt.ProjectiveTransform4f
    assert (
        lanes != projective
        and lanes != 3
        and djpt.ScalarTransform4f(lanes) @ host == djpt.ScalarTransform4f(lanes @ host)
    )
    with pytest.raises(SceneError, match=r"AffineTransform4f @ AffineTransform3f: the two can't be composed"):
        lanes @ djpt.Transform3f()
    with pytest.raises(SceneError, match=r"composed and applied with the operator @"):
        lanes * lanes
    with pytest.raises(TypeError, match="unsupported operand"):
        lanes @ "x"


REFUSED = {
    "two numbers": (lambda t: t.translate([1, 2]), r"translate: must be three numbers, found list \[1, 2\]"),
    "a string": (lambda t: t.rotate("x", 5), r"rotate: must be three numbers, found str 'x'"),
    "an angle": (lambda t: t.rotate([0, 1, 0], "x"), r"rotate: must be a number, found str 'x'"),
    "a small matrix": (lambda t: djpt.Transform4f(djpt.Matrix3f(1)), r"must be a 4x4 matrix, found Matrix3f"),
    "few rows": (lambda t: djpt.Transform4f([[1, 0], [0, 1]]), r"must be a 4x4 matrix, found list"),
    "of the plane": (lambda t: djpt.Transform4f(djpt.Transform3f()), r"must be a 4x4 matrix, found AffineTransform3f"),
    "rows of points": (lambda t: t @ np.ones((5, 3)), r"must be three numbers, found ndarray"),
}


@pytest.mark.parametrize(("build", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_refused(build: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        build(djpt.Transform4f())


def test_a_long_axis(mi: Any) -> None:
    """Mitsuba's matrix, with a warning, and the inverse that belongs to it."""
    with pytest.warns(UserWarning, match="rotate: the axis has the length 2"):
        ours = djpt.Transform4f().rotate([0, 2, 0], 30)
    assert_same(ours.matrix, mi.Transform4f().rotate([0, 2, 0], 30).matrix)
    assert_same((ours @ ours.inverse()).matrix, np.eye(4))
    with pytest.raises(AmbiguityError):
        ours @ djpt.Vector3f(1, 0, 0)


# ---------------------------------------------------------------- parameters


def test_parameters_are_transforms(mi: Any) -> None:
    def moved(m: Any) -> Any:
        params = m.traverse(m.load_dict({"type": "rectangle", "to_world": m.ScalarTransform4f().translate([1, 2, 3])}))
        before = params["to_world"]
        params["to_world"] = m.Transform4f().rotate(UNIT, 30) @ before
        params.update()
        assert isinstance(before, m.Transform4f) and isinstance(params["to_world"], m.Transform4f)
        return params["to_world"].matrix

    assert_same(moved(djpt), moved(mi))


def test_reading_a_transform_keeps_its_precision() -> None:
    place = djpt.ScalarTransform4f().translate([0.1, 0.2, 0.3])
    shape = djpt.load_dict({"type": "rectangle", "to_world": place})
    params = djpt.traverse(shape)
    params["to_world"] = params["to_world"]
    assert params.update() == [] and shape.to_world == place


def test_edits_in_place_are_noticed() -> None:
    shape = djpt.load_dict({"type": "rectangle"})
    params = djpt.traverse(shape)
    params["to_world"].matrix[0, 3] = 5
    assert [names for _, names in params.update()] == [{"to_world"}]
    assert shape.to_world == djpt.ScalarTransform4f().translate([5, 0, 0])


def test_unusable_parameters() -> None:
    # Shapes without silhouettes can't follow gradients.
    params = djpt.traverse(djpt.load_dict({"type": "sdfgrid", "grid": np.linspace(-1, 1, 8).reshape(2, 2, 2, 1)}))
    x = djpt.Float(1)
    dr.enable_grad(x)
    for value, message in (
        (djpt.Transform4f().translate([x, 0, 0]), "gradients"),
        (djpt.Transform4f().scale(djpt.Float(1, 2)), "must be a 4x4 matrix"),
        (djpt.Transform4f().scale(0), "singular|finite"),
    ):
        with pytest.raises(ParameterError, match=message):
            params["to_world"] = value


def test_vertices_differentiate() -> None:
    """A script's move of a mesh: derivatives arrive at the offset."""
    positions = djpt.traverse(djpt.load_dict({"type": "cube"}))["vertex_positions"]
    offset = djpt.Float(0.5)
    dr.enable_grad(offset)
    points = dr.unravel(djpt.Point3f, positions)
    moved = dr.ravel(djpt.Transform4f().translate([offset, 0, 0]).scale(2).transform_point(points))
    dr.backward(dr.sum(moved))
    assert offset.grad[0] == dr.width(points)


def test_transforms_of_the_plane_in_descriptions(mi: Any) -> None:
    """In djpt's own loader, in Mitsuba's through the bridge, in scene files and as a parameter."""
    turned = djpt.ScalarTransform3f().translate([0.25, 0]).rotate(30).scale(3)
    for to_uv in (turned, djpt.Transform3f(turned), turned.expand()):
        texture = {"type": "checkerboard", "to_uv": to_uv}
        params = djpt.traverse(djpt.load_dict(texture))
        assert type(params["to_uv"]) is djpt.ScalarTransform3f
        for found in (params["to_uv"], mi.traverse(mi.load_dict(djpt.validation.to_mitsuba(texture)))["to_uv"]):
            assert_same(found.matrix, turned.matrix)
        assert_same(djpt.traverse(djpt.load_string(djpt.to_xml(texture)))["to_uv"].matrix, turned.matrix)
    assert turned.expand().extract() == turned


@pytest.mark.parametrize("name", ["Transform4f", "ScalarTransform4f"])
def test_what_is_meant_by_name(name: str) -> None:
    t = getattr(djpt, name)().translate([1, 2, 3]).scale([1, 2, 1])
    x = djpt.Vector3f(1, 2, 3)
    assert_same(t.transform_affine(v=x), t.transform_vector(x))
    assert_same(t.transform_affine(n=x), t.transform_normal(x))
    assert_same(t.transform_affine(p=[1, 2, 3]), t.transform_point(np.array([1, 2, 3])))
    assert_same(t.transform_affine(ray=djpt.Ray3f(x, x)).d, t.transform_vector(x))
    for arguments in ({}, {"v": x, "n": x}):
        with pytest.raises(SceneError, match="transform_affine: takes one of p, v, n and ray"):
            t.transform_affine(**arguments)
    assert (
        [*inspect.signature(t.rotate).parameters]
        == [*inspect.signature(type(t).rotate).parameters]
        == ["axis", "angle"]
    )


@pytest.mark.parametrize("name", ["Transform4f", "ScalarTransform4f", "ScalarProjectiveTransform4f"])
def test_a_matrix_with_its_inverse(name: str) -> None:
    kind = getattr(djpt, name)
    t = kind().translate([1, 2, 3]).scale([1, 2, 1])
    again = kind(t.matrix, t.inverse_transpose)
    assert again == t
    assert_same(again.inverse_transpose, t.inverse_transpose)
    if not t.on_lanes:
        with pytest.raises(SceneError, match="isn't the transposed inverse"):
            kind(t.matrix, t.matrix)
