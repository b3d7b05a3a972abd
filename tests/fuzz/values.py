"""Values of parameters: what is allowed, what nearly is, and nonsense."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

from tests.fuzz.declarations import Declaration
from tests.fuzz.seeds import READERS

__all__ = ["NONSENSE", "Code", "nonsense", "numbers", "value"]


class Code(str):
    """A Python expression: it is its own `repr`, so that dicts of such are programs."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


TEXTS = (
    "nan", "inf", "-inf", "1e39", "-1e300", "10**400", "-1", "0", "-0.0", "1e-40", "2**31", "2**63", "-2**64", "''",
    "'abc'", "'\\0'", "'\U0001f4a5é'", "'x' * 100000", "b'x'", "'..'", "'1, 2, 3'", "'\\ud800'", "[]", "[1]",
    "[[1, 2], [3]]", "[[]]", "()", "{}", "set()", "[nan, 1, 2]", "['a', 'b', 'c']", "[None] * 3", "None", "True",
    "...", "object()", "float", "(lambda *x: 0)", "range(3)", "1j", "slice(1)", "np.zeros(0)", "np.full(3, nan)",
    "np.zeros((2, 2), complex)", "np.array('a')", "np.float16(1)", "np.int8(-1)", "np.zeros((0, 0, 3))",
    "np.zeros((1, 1, 1, 1, 1))", "np.array(None)", "np.bool_(True)", "np.datetime64('2020')", "djpt.Float(1)",
    "djpt.Float([1, 2])", "djpt.Float()", "djpt.Color3f(nan)", "djpt.UInt32(7)", "djpt.Bool(True)",
    "djpt.TensorXf(np.zeros((0, 0, 3)))", "djpt.Point3f([1, 2], 3, 4)", "T()", "T([[0] * 4] * 4)",
    "djpt.Transform4f()", "djpt.Matrix4f(nan)", "dr.opaque(djpt.Float, nan)", "djpt.Bitmap(np.zeros((1, 1, 3)))",
    "{1: 2}", "{'type': 5}", "{'type': 'ref', 'id': 'nothing'}", "{'type': 'ref'}", "{'type': 'nothing'}",
    "{'type': 'diffuse'}", "{'type': 'rgb', 'value': [nan] * 3}", "{'type': 'scene'}", "{'type': 'sphere'}",
    "djpt.load_dict({'type': 'diffuse'})", "djpt.load_dict({'type': 'uniform', 'value': 0.5})", "djpt",
)  # fmt: skip

NONSENSE = tuple(map(Code, TEXTS))
"""Expressions that few parameters can take."""


def nonsense() -> st.SearchStrategy[Any]:
    """Anything."""
    return st.sampled_from(NONSENSE)


def numbers(low: float | None, high: float | None) -> st.SearchStrategy[float]:
    """Ordinary numbers in a range."""
    least = 0.0 if low is None else low
    most = max(least, min(least + 4, math.inf if high is None else high))
    return st.sampled_from(sorted({0.5 * (least + most), 0.9 * least + 0.1 * most, 0.1 * least + 0.9 * most}))


def extremes(low: float | None, high: float | None) -> st.SearchStrategy[Any]:
    """Bounds, numbers beside them, and all of single precision."""
    bounds = [x for x in (low, high) if x is not None]
    beside = [math.nextafter(x, to) for x in bounds for to in (-math.inf, math.inf)]
    return st.one_of(
        st.sampled_from([*bounds, *beside, 0.0, -0.0, 1e-30, 1e-10, 1e10, 3.4e38, -1.0]),
        st.floats(width=32, allow_nan=False, allow_infinity=False),
    )


WORDS = (
    "gaussian", "beckmann", "ggx", "bilinear", "nearest", "repeat", "clamp", "mirror", "x", "y", "50mm", "0mm",
    "-5mm", "auto", "rgb", "rgba", "luminance", "multichannel", "float16", "float32", "uint32", "openexr", "pfm",
    "Au", "bk7", "vertex_color", "face_x", "aa:depth", "n:sh_normal,d:depth", "a:nothing", ":", "air", "1.5",
)  # fmt: skip
"""Texts that mean something to some parameter."""

ARRAYS = (
    "np.full((2, 2, 3), 0.5)", "np.full((2, 2, 2, 1), 0.5)", "[0.5] * 3", "[[0, 0, 0, 1.0]]", "'400, 500, 600'",
    "np.zeros((4, 3))", "[(400, 0.5), (700, 1.0)]", "T().scale(2)", "(lambda p: dr.norm(p) - 0.7)", "[0.1] * 18",
    "0.5",
)  # fmt: skip
"""Arrays that mean something to some parameter."""


@st.composite
def value(draw: st.DrawFn, declaration: Declaration, wild: bool, nested: Any) -> Any:
    """A value of a parameter; `nested` gives strategies of plugins by kind. If `wild`, extremes are among them."""
    sort, low, high = declaration.sort, declaration.low, declaration.high
    if declaration.key == "filename":
        return draw(st.sampled_from([*READERS, *(["", ".", "no.obj", "a.obj/b"] if wild else [])]))
    if sort in ("float", "integer"):
        number = draw(extremes(low, high) if wild and draw(st.booleans()) else numbers(low, high))
        return number if sort == "float" else int(number)
    if sort == "boolean":
        return draw(st.booleans())
    if sort == "string":
        return draw(st.sampled_from(declaration.choices or WORDS))
    if sort == "vector":
        return draw(st.lists(numbers(-2, 2) if not wild else extremes(None, None), min_size=3, max_size=3))
    if sort == "transform":
        return Code(draw(transforms(wild)))
    if sort in ("plugin", "child", "children"):
        return draw(nested(declaration.kind))
    if sort == "raw":
        choice = st.one_of(numbers(low, high), st.sampled_from(list(map(Code, ARRAYS))), st.sampled_from(WORDS))
        return draw(choice)
    kind = "volume" if sort == "volume" else "texture"
    return draw(st.one_of(extremes(low, high) if wild else numbers(low, high), nested(kind)))


def transforms(wild: bool) -> st.SearchStrategy[str]:
    """Expressions of transforms."""
    ordinary = ["T()", "T().translate([0, 1, 2])", "T().scale(2)", "T().rotate([0, 1, 0], 30)", "T().scale([1, 2, -1])",
                "T().look_at(origin=[0, 0, -4], target=[0, 0, 0], up=[0, 1, 0])", "np.eye(4)"]  # fmt: skip
    degenerate = ["T().scale(0)", "T().scale(1e-30)", "T().scale(1e30)", "T().translate([1e38, 0, 0])",
                  "np.ones((4, 4))", "[[1, 0], [0, 1]]", "T().scale([1, 1e-20, 1e20])"]  # fmt: skip
    return st.sampled_from(ordinary + degenerate if wild else ordinary)
