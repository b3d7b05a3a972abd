"""Faults: derivatives of a user's BSDF that are wrong, and pieces of djpt's own code that are replaced."""

from __future__ import annotations
import __future__

import contextlib
import importlib
import inspect
import math
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

import drjit as dr

import djpt
from djpt.core.warp import square_to_cosine_hemisphere
from djpt.description.properties import Properties

__all__ = ["FAULTS", "Faulty", "planted"]


Fault = Callable[[Any, Any], Any]


def changed(value: Any, factor: Any) -> Any:
    """A value whose derivative is multiplied by a factor."""
    still = dr.detach(value)
    return still + factor * (value - still)


FAULTS: dict[str, tuple[Fault, Fault]] = {
    "wrong sign": (lambda a, si: changed(a, -1), lambda a, si: changed(a, -1)),
    "zero": (lambda a, si: dr.detach(a), lambda a, si: dr.detach(a)),
    "missing factor of a tenth": (lambda a, si: changed(a, 0.9), lambda a, si: changed(a, 0.9)),
    "twice": (lambda a, si: changed(a, 2), lambda a, si: changed(a, 2)),
    "no derivative of lit surfaces": (lambda a, si: dr.detach(a), lambda a, si: a),
    "the derivative of a square": (
        lambda a, si: changed(a, 2 * dr.detach(a)),
        lambda a, si: changed(a, 2 * dr.detach(a)),
    ),
    "a channel dropped": (
        lambda a, si: changed(a, djpt.Color3f(1, 0, 1)),
        lambda a, si: changed(a, djpt.Color3f(1, 0, 1)),
    ),
    "channels swapped": (lambda a, si: dr.detach(a) + swapped(a), lambda a, si: dr.detach(a) + swapped(a)),
    "a cosine too much": (lambda a, si: changed(a, dr.abs(si.wi.z)), lambda a, si: changed(a, dr.abs(si.wi.z))),
    "half of the surface": (lambda a, si: changed(a, dr.select(si.p.x > 0, 1, 0)),) * 2,
}
"""What happens to the albedo in `eval` and in `sample`, by the name of the fault."""


def swapped(albedo: Any) -> Any:
    """The derivative of a colour with red and blue exchanged."""
    away = albedo - dr.detach(albedo)
    return djpt.Color3f(away.z, away.y, away.x)


class Faulty(djpt.BSDF):
    """Parameters: `albedo` (texture, default 0.5), `fault` (a name in FAULTS, or none)."""

    children = ("albedo",)

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.albedo = props.texture("albedo", 0.5, low=0.0, high=1.0)
        nothing: Fault = lambda a, si: a  # noqa: E731
        self.of_eval, self.of_sample = FAULTS.get(props.string("fault", ""), (nothing, nothing))

    def flags(self) -> Any:
        return djpt.BSDFFlags.DiffuseReflection | djpt.BSDFFlags.FrontSide

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        above = (si.wi.z > 0) & (wo.z > 0)
        albedo = self.of_eval(self.albedo.eval(si, active), si)
        return dr.select(above, albedo * (wo.z / math.pi), 0), dr.select(above, wo.z / math.pi, 0)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
        wo = square_to_cosine_hemisphere(sample2)
        pdf = wo.z / math.pi
        bs = djpt.BSDFSample3f.of(wo, pdf, djpt.BSDFFlags.DiffuseReflection)
        albedo = self.of_sample(self.albedo.eval(si, active), si)
        return bs, dr.select((si.wi.z > 0) & (pdf > 0), albedo, 0)


djpt.register_bsdf("faulty_diffuse", Faulty)


@contextlib.contextmanager
def planted(target: str, old: str, new: str) -> Iterator[None]:
    """Replace ``old`` in the source of a function for a while.

    `target` is ``module:function`` or ``module:Class.method``; the text must be there once, so that a fault can't
    silently become none when the code changes.
    """
    module_name, _, path = target.partition(":")
    module = importlib.import_module(module_name)
    holder_path, _, name = path.rpartition(".")
    holder = getattr(module, holder_path) if holder_path else module
    function = getattr(holder, name)
    source = textwrap.dedent(inspect.getsource(function))
    assert source.count(old) == 1, f"{target}: {old!r} is there {source.count(old)} times"
    code = compile(source.replace(old, new), f"<{target}, changed>", "exec", __future__.annotations.compiler_flag)
    names = dict(inspect.unwrap(function).__globals__)
    exec(code, names)
    setattr(holder, name, names[name])
    try:
        yield
    finally:
        setattr(holder, name, function)
