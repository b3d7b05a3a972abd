"""What a plugin does depends on what its class says, and not on where its file stands: in djpt or in a script."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.core.transforms import ScalarTransform4f as T
from djpt.description.plugin import NotMovable
from djpt.jit.types import Vector3f
from djpt.scene.normalization.normalized_scene import WorkingFrame
from djpt.scene.normalization.plugin_copies import PluginCopies
from tests.kit.processes import ROOT

PAGES = ("CONTRIBUTING.md", "docs/guides/plugins.md")

LAX = '''
class Lax(djpt.BSDF):
    """Grey, in the style of scripts: it edits its arguments, and answers with numbers."""

    def components(self):
        return (int(djpt.BSDFFlags.DiffuseReflection | djpt.BSDFFlags.FrontSide),)

    def eval_pdf(self, ctx, si, wo, active):
        active &= (si.wi.z > 0) & (wo.z > 0)
        si.wi.z *= -1
        wo.z *= 0.5
        return dr.select(active, 2 * wo.z / math.pi, 0), dr.select(active, 2 * wo.z / math.pi, 0)

    def sample(self, ctx, si, sample1, sample2, active):
        sample2 *= 0.5
        bs = djpt.BSDFSample3f()
        bs.wo, bs.pdf, bs.sampled_type = [0, 0, 1], 0.5, self.components()[0]
        return bs, 0.25

    def eval_null_transmission(self, si, active):
        return 0.5


class Lanes(Integrator):
    """Draws numbers in the style of scripts."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        active &= sampler.wavefront_size() > 1
        return sampler.next_1d(active), True, []


djpt.register_bsdf("lax", Lax)
djpt.register_integrator("lanes", Lanes)
'''


def source() -> str:
    """The classes of the pages, what they import, and the lines that register them; no scenes, no images."""
    if not all((ROOT / page).exists() for page in PAGES):
        pytest.skip("not a working copy of the repository")
    code = ["import drjit as dr"]
    for page in PAGES:
        for block in re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE):
            if block.startswith(" "):
                continue  # lines to add to a file
            for node in ast.parse(block).body:
                # Shapes are left out: other tests have plugins of other kinds with their names.
                registers = isinstance(node, ast.Expr) and re.search("register_(bsdf|integrator)", ast.unparse(node))
                if registers or isinstance(node, ast.Import | ast.ImportFrom | ast.ClassDef):
                    code.append(ast.unparse(node))
    futures = [line for line in dict.fromkeys(code) if line.startswith("from __future__")]
    return "\n".join([*futures, *(line for line in code if line not in futures), LAX])


def ball(bsdf: str, integrator: Any, schedule: str = "auto") -> Any:
    """The image of a ball, as an array."""
    scene = djpt.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": 35,
                "to_world": T().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "ball": {"type": "sphere", "bsdf": {"type": bsdf}},
            "lamp": {"type": "point", "position": [3, 2, 8], "intensity": 100.0},
            "sky": {"type": "constant", "radiance": 0.1},
        }
    )
    return djpt.render(scene, spp=4, integrator=djpt.load_dict(integrator), schedule=schedule).numpy()


def moved(bsdf: Any) -> str:
    try:
        return type(PluginCopies(WorkingFrame(0.125, (1, 2, 3))).copy_of(bsdf)).__name__
    except NotMovable as error:
        return str(error)


def answers(bsdf: Any) -> dict[str, Any]:
    """What a BSDF answers to lists, and what is left of the arrays that it was given."""
    si = dr.zeros(djpt.SurfaceInteraction3f, 2)
    si.wi, si.t = Vector3f(0.6, 0, 0.8), 1.0
    wo, active, ctx = Vector3f(0, 0.6, 0.8), djpt.Bool(True, False), djpt.BSDFContext()
    value, pdf = bsdf.eval_pdf(ctx, si, wo, active)
    listed, _ = bsdf.eval_pdf(ctx, si, [0, 0.6, 0.8], active=True)
    bs, weight = bsdf.sample(ctx, si, 0.3, [0.2, 0.7], active)
    found = {"value": value, "pdf": pdf, "listed": listed, "wo": bs.wo, "weight": weight}
    found |= {"null": bsdf.eval_null_transmission(si, active), "wi": si.wi, "given": wo, "active": active}
    return {name: (type(x).__name__, np.array(x).tolist()) for name, x in found.items()}


def behaviour(module: Any) -> dict[str, Any]:
    """All that could depend on the place of the classes of a module."""
    found: dict[str, Any] = {}
    for name in ("minnaert", "lommel_seeliger", "lax"):
        bsdf: Any = djpt.load_dict({"type": name})
        assert type(bsdf).__module__ == module.__name__
        found[name] = (bsdf.is_symmetric, bsdf.flags(), moved(bsdf), answers(bsdf))
        for integrator in ("path", "ptracer"):
            found[f"{name} by {integrator}"] = ball(name, {"type": integrator}).tobytes()
    for name in ("ambient_occlusion", "facing_ratio", "hazy_path", "short_path", "lanes"):
        integrator: Any = djpt.load_dict({"type": name})
        assert type(integrator).__module__ == module.__name__
        found[name] = integrator.is_pure(), integrator.fits_any_frame(), ball("diffuse", {"type": name}).tobytes()
        nested = {"type": "moment", "nested": {"type": name}}
        found[f"nested {name}"] = ball("diffuse", nested, "wave").tobytes()
    return found


def test_a_plugin_does_the_same_in_djpt_and_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = source()
    for name in ("copied_outside", "copied_inside"):
        (tmp_path / f"{name}.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    outside = behaviour(importlib.import_module("copied_outside"))
    monkeypatch.setattr(djpt, "__path__", [*djpt.__path__, str(tmp_path)])
    inside = behaviour(importlib.import_module("djpt.copied_inside"))
    assert inside == outside
    # Leniency isn't an agreement of two failures.
    _, _, _, lax = inside["lax"]
    assert lax["wi"][1] == pytest.approx(np.array([[0.6], [0], [0.8]])) and lax["active"][1] == [True, False]
    assert lax["listed"][0] == lax["value"][0] == lax["weight"][0] == "Array3f" and lax["null"][1][0] == [0.5]
    assert not inside["minnaert"][0] and "has no move_into of its own" in inside["minnaert"][2]
