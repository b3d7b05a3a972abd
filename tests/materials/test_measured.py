"""Measured materials: the numbers of Mitsuba, and those of the model that a file was computed from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import pytest

import djpt
from djpt.description.tensor_files import read_tensors, write_tensors
from tests.kit.measured import ALPHA, TINT, anisotropic, rough_metal
from tests.kit.same_calls import same

FILES = {
    "metal": rough_metal,
    "made up": anisotropic,
    "half": lambda: anisotropic(2),
    "quarter": lambda: anisotropic(4),
}
COUNT = 4096


def question(module: Any, description: dict[str, Any], below: bool = True) -> Any:
    """(value, density, sample, weight) for random directions."""
    rng = np.random.default_rng(1)
    wi, wo = (rng.normal(size=(3, COUNT)) for _ in range(2))
    wi, wo = (v / np.linalg.norm(v, axis=0) for v in (wi, wo))
    if not below:
        wi[2], wo[2] = np.abs(wi[2]), np.abs(wo[2])
    si = dr.zeros(module.SurfaceInteraction3f, COUNT)
    si.wi = module.Vector3f(*wi.astype(np.float32))
    si.sh_frame = module.Frame3f(module.Normal3f(0, 0, 1))
    bsdf, ctx = module.load_dict(description), module.BSDFContext()
    value, pdf = bsdf.eval_pdf(ctx, si, module.Vector3f(*wo.astype(np.float32)))
    numbers = (rng.random(COUNT).astype(np.float32) for _ in range(3))
    s1, x, y = (module.Float(n) for n in numbers)
    bs, weight = bsdf.sample(ctx, si, s1, module.Point2f(x, y))
    found = dr.max(weight) > 0
    # Directions below the horizon are lost: only there, what they would have been differs.
    return value, pdf, dr.select(found, bs.wo, 0), dr.select(found, bs.pdf, 0), weight


SLOW = pytest.mark.slow  # Mitsuba compiles for ten seconds


@pytest.mark.parametrize("file", ["metal", *(pytest.param(name, marks=SLOW) for name in FILES if name != "metal")])
def test_numbers_are_mitsubas(file: str) -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    same(lambda m: question(m, {"type": "measured", "filename": FILES[file]()}), mi, rtol=2e-3, atol=5e-4)


def test_a_tabulated_metal_is_the_metal() -> None:
    tint = {"type": "rgb", "value": list(TINT)}
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": ALPHA, "specular_reflectance": tint}
    exact = np.array(question(djpt, metal, below=False)[0])
    coarse, fine = (
        np.abs(np.array(question(djpt, {"type": "measured", "filename": rough_metal(size)}, below=False)[0]) - exact)
        for size in (17, 65)
    )
    assert coarse.mean() < 0.03 * exact.mean()
    assert fine.mean() < 0.01 * exact.mean() < coarse.mean()


def test_two_measurements_in_one_scene() -> None:
    """Each is traced for itself: none gets the numbers of the other."""
    files = rough_metal(17), anisotropic(1)

    def scene(left: str, right: str) -> dict[str, Any]:
        balls = {
            name: {"type": "sphere", "center": [x, 0, 0], "bsdf": {"type": "measured", "filename": file}}
            for name, x, file in (("left", -1, left), ("right", 1, right))
        }
        look = djpt.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
        film = {"type": "hdrfilm", "width": 16, "height": 8, "rfilter": {"type": "box"}}
        camera = {"type": "perspective", "to_world": look, "film": film}
        return {
            "type": "scene",
            "path": {"type": "path", "max_depth": 2},
            "sky": {"type": "constant"},
            **balls,
            "c": camera,
        }

    both, swapped = (np.array(djpt.render(djpt.load_dict(scene(*pair)), spp=64)) for pair in (files, files[::-1]))
    halves = (both[:, :8].mean(), both[:, 8:].mean()), (swapped[:, 8:].mean(), swapped[:, :8].mean())
    np.testing.assert_allclose(*halves, rtol=0.03)
    assert abs(halves[0][0] - halves[0][1]) > 0.1 * halves[0][0]


def test_errors_name_the_file(tmp_path: Path) -> None:
    fields = read_tensors(rough_metal(17))

    def load(**changed: Any) -> None:
        path = tmp_path / "x.bsdf"
        write_tensors(path, {name: value for name, value in {**fields, **changed}.items() if value is not None})
        djpt.load_dict({"type": "measured", "filename": str(path)})

    with pytest.raises(djpt.DjptError, match=r"measured: 'filename' .*x.bsdf' isn't a measured material: .*'sigma'"):
        load(sigma=None)
    with pytest.raises(djpt.DjptError, match=r"'ndf' must be float32 with 2 axes, found float64\(17, 17\)"):
        load(ndf=fields["ndf"].astype(np.float64))
    with pytest.raises(djpt.DjptError, match="'rgb' must have the shape"):
        load(rgb=fields["rgb"][:, :, :2])
    with pytest.raises(djpt.DjptError, match="has spectra: rendering is in colours"):
        load(rgb=None, wavelengths=np.ones(4, np.float32))
    with pytest.raises(djpt.DjptError, match=r"'filename' .*nowhere"):
        djpt.load_dict({"type": "measured", "filename": "nowhere.bsdf"})
