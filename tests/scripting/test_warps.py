"""Warps: the same numbers as Mitsuba's, lists for arguments, and inverses that lead back."""

from __future__ import annotations

import re
from inspect import signature
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from tests.kit.arrays import in_numpy, rows

NUMBERS = {"alpha": 0.3, "kappa": 7.0, "cos_cutoff": 0.3, "v00": 1.0, "v10": 3.0, "v01": 5.0, "v11": 7.0} | {
    "v0": 3.0,
    "v1": 5.0,
    "a": -0.5,
    "b": 0.2,
    "c": 1.5,
}

INVERSES = [
    *("uniform_disk", "uniform_disk_concentric", "uniform_triangle", "tent", "uniform_sphere", "uniform_hemisphere"),
    *("cosine_hemisphere", "uniform_cone", "beckmann", "von_mises_fisher", "uniform_spherical_lune"),
]


def calls(mi: Any) -> list[str]:
    return [name for name in dir(mi.warp) if not name.startswith("_")]


def arguments(name: str, documentation: str) -> dict[str, Any]:
    """Arguments for a warp by the types in Mitsuba's signature: points of [0, 1)^n, directions of the sphere."""
    rng = np.random.default_rng(3)
    described = re.search(r"\((.*)\) ->", documentation.split("\n")[0])
    assert described
    found: dict[str, Any] = {}
    for part in described.group(1).split(", "):
        parameter, kind = part.split(": ")
        uniform = rng.random((3, 50))
        if parameter in NUMBERS:
            found[parameter] = NUMBERS[parameter]
        elif "Float" in kind:
            found[parameter] = uniform[0]
        elif "Point2f" in kind:
            found[parameter] = uniform[:2] * (0.5 if "triangle" in name else 1)
        elif "Point3f" in kind:
            found[parameter] = uniform
        else:
            direction = uniform - [[0.5], [0.5], [0.0]]
            found[parameter] = direction / np.linalg.norm(direction, axis=0)
    return found


def converted(found: dict[str, Any]) -> dict[str, Any]:
    def array(value: Any) -> Any:
        if isinstance(value, float):
            return value
        parts = rows(np.atleast_2d(value))
        return {1: djpt.Float, 2: djpt.Point2f, 3: djpt.Vector3f}[len(parts)](*parts)

    return {name: array(value) for name, value in found.items()}


def flat(result: Any) -> list[np.ndarray]:
    return [in_numpy(x) for x in (result if isinstance(result, tuple) else (result,))]


def test_all_warps_have_mitsubas_values_and_parameters(mi: Any) -> None:
    for name in calls(mi):
        ours, theirs = getattr(djpt.warp, name), getattr(mi.warp, name)
        found = arguments(name, theirs.__doc__)
        assert list(signature(ours).parameters) == list(found), name
        values = converted(found)
        for a, b in zip(flat(ours(**values)), flat(theirs(**values)), strict=True):
            a, b = np.broadcast_arrays(a, b)
            # Densities are 0 outside of their domain here; Mitsuba's go on as if there were no end.
            inside = a > 0 if name.endswith("_pdf") else np.ones(a.shape, bool)
            assert inside.mean() > 0.1
            np.testing.assert_allclose(a[inside], b[inside], rtol=3e-5, atol=3e-6, err_msg=name)


@pytest.mark.parametrize("name", INVERSES)
def test_inverses_lead_back(name: str) -> None:
    samples = rows(np.random.default_rng(1).uniform(1e-3, 1 - 1e-3, (2, 200)))
    more: tuple[Any, ...] = ()
    if "lune" in name:
        more = tuple(dr.normalize(djpt.Vector3f(*n)) for n in ((-0.1, 0.8, 0.2), (0.2, 0.7, 0.2)))
    elif name in ("uniform_cone", "beckmann", "von_mises_fisher"):
        more = (0.3 if name != "von_mises_fisher" else 10.0,)
    inverse = name.replace("_concentric", "") + "_to_square" + ("_concentric" if "concentric" in name else "")
    sample = djpt.Point2f(*samples)
    back = getattr(djpt.warp, inverse)(getattr(djpt.warp, f"square_to_{name}")(sample, *more), *more)
    np.testing.assert_allclose(in_numpy(back), in_numpy(sample), atol=2e-4)


def test_centres_and_poles_are_finite() -> None:
    """Where polar coordinates are singular."""
    middle = [0.5, 0.5]
    for value in (
        djpt.warp.square_to_uniform_square_concentric(middle),
        djpt.warp.square_to_beckmann(middle, 0.2),
        djpt.warp.beckmann_to_square([0, 0, 1], 0.2),
        djpt.warp.uniform_cone_to_square([0, 0, 1], 0.2),
        djpt.warp.square_to_von_mises_fisher(middle, 0),
    ):
        assert np.isfinite(in_numpy(value)).all()


@pytest.mark.parametrize("sample", [[0.25, 0.75], (0.25, 0.75), np.array([0.25, 0.75]), dr.scalar.Array2f(0.25, 0.75)])
def test_lists_tuples_and_arrays_are_points(sample: Any) -> None:
    direction = djpt.warp.square_to_uniform_hemisphere(sample)
    expected = djpt.warp.square_to_uniform_hemisphere(djpt.Point2f(0.25, 0.75))
    assert dr.all(direction == expected)
    assert dr.all(djpt.warp.square_to_uniform_hemisphere(sample=sample) == expected)


def test_what_no_point_can_be_made_from() -> None:
    with pytest.raises(djpt.errors.ArgumentError, match=r"square_to_uniform_disk\(\): 'sample' must be something that"):
        djpt.warp.square_to_uniform_disk([1, 2, 3])


def test_arrays_stay_the_variables_that_they_are() -> None:
    """A conversion would be seen in kernels."""
    kept: list[Any] = []

    @djpt.types.converting
    def keep(p: Point2f) -> None:  # type: ignore[name-defined] # noqa: F821
        kept.append(p)

    point = djpt.Point2f(1, 2)
    keep(point)
    assert kept[0] is point
