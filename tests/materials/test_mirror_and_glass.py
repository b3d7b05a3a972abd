"""Mirrors and glass as the plugins `mirror` and `glass` have them: Schlick's approximation, lobes shown alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import djpt
from djpt.core.records import BSDFFlags
from djpt.jit.types import Float
from djpt.materials.fresnel import fresnel, fresnel_schlick
from tests.kit.smooth_materials import ANGLES, sampled, weights

# ---------------------------------------------------------------- mirror


def test_a_plain_mirror_reflects_everything_but_only_in_front() -> None:
    found = sampled(djpt.load_dict({"type": "mirror"}), ANGLES, 0.5)
    np.testing.assert_array_equal(found["weight"], 1)
    np.testing.assert_allclose(found["wo"], ANGLES * [[-1], [-1], [1]], atol=1e-7)
    assert not weights({"type": "mirror"}, -ANGLES).any()


def test_a_mirror_of_a_metal_is_a_conductor() -> None:
    np.testing.assert_array_equal(
        weights({"type": "mirror", "material": "Cu", "reflectance": 0.5}),
        weights({"type": "conductor", "material": "Cu", "specular_reflectance": 0.5}),
    )


def test_schlicks_mirror_starts_from_its_colour() -> None:
    colour = np.array([0.9, 0.5, 0.1])[:, None]
    rgb = {"type": "rgb", "value": colour.ravel().tolist()}
    found = weights({"type": "mirror", "fresnel": "schlick", "reflectance": rgb})
    np.testing.assert_allclose(found, colour + (1 - colour) * (1 - ANGLES[2]) ** 5, atol=1e-6)


@pytest.mark.parametrize("metal", ["Au", "Ag", "Cu"])
def test_schlicks_metal_is_near_the_exact_one(metal: str) -> None:
    exact, short, flat = (
        weights({"type": "mirror", "material": metal, "fresnel": f}) for f in ("exact", "schlick", "none")
    )
    np.testing.assert_allclose(short[:, 0], exact[:, 0], atol=1e-6)
    assert 1e-3 < np.abs(short - exact).max() < 0.1
    np.testing.assert_allclose(flat, np.broadcast_to(exact[:, :1], flat.shape), atol=1e-6)


def test_parameters_of_a_mirror() -> None:
    assert list(djpt.traverse(djpt.load_dict({"type": "mirror"}))) == ["reflectance.value"]
    gold = djpt.traverse(djpt.load_dict({"type": "mirror", "material": "Au"}))
    assert sorted(gold) == ["eta.value", "k.value", "reflectance.value"]


# ---------------------------------------------------------------- glass

BOTH = np.concatenate([ANGLES, -ANGLES], axis=1)


SAMPLES = np.linspace(0, 0.999, 41)


def test_glass_is_a_dielectric() -> None:
    indices = {"int_ior": 1.5, "ext_ior": 1.0}
    for sample1 in SAMPLES:
        glass, plain = (sampled(djpt.load_dict({"type": t, **indices}), BOTH, sample1) for t in ("glass", "dielectric"))
        for name, value in plain.items():
            np.testing.assert_array_equal(glass[name], value)


@pytest.mark.parametrize(("name", "model"), [("exact", fresnel), ("schlick", fresnel_schlick)])
def test_lobes_shown_alone_add_up_to_glass(name: str, model: Any) -> None:
    base = {"type": "glass", "int_ior": 1.5, "ext_ior": 1.0, "fresnel": name}
    share, _, _, eta_ti = (x.numpy() for x in model(Float(BOTH[2]), Float(1.5)))
    reflected, refracted = {**base, "transmission": False}, {**base, "reflection": False}
    for sample1 in (0.01, 0.99):  # the lobe doesn't depend on it
        a, b = sampled(djpt.load_dict(reflected), BOTH, sample1), sampled(djpt.load_dict(refracted), BOTH, sample1)
        np.testing.assert_array_equal([a["pdf"], b["pdf"]], 1)
        np.testing.assert_array_equal(a["type"], int(BSDFFlags.DeltaReflection))
        np.testing.assert_array_equal(b["type"], int(BSDFFlags.DeltaTransmission))
        np.testing.assert_allclose(a["weight"], np.tile(share, (3, 1)), atol=1e-6)
        np.testing.assert_allclose(b["weight"], np.tile((1 - share) * eta_ti**2, (3, 1)), atol=1e-6)
    both = sampled(djpt.load_dict(base), BOTH, 0.0)
    np.testing.assert_allclose(both["pdf"], share, atol=1e-7)


def test_refraction_alone_at_equal_indices_changes_nothing() -> None:
    for model in ("exact", "schlick"):
        pane = {"type": "glass", "int_ior": 1.0, "ext_ior": 1.0, "reflection": False, "fresnel": model}
        found = sampled(djpt.load_dict(pane), BOTH, 0.5)
        np.testing.assert_allclose(found["wo"], -BOTH, atol=1e-5)
        np.testing.assert_array_equal(found["weight"], 1)
        np.testing.assert_array_equal(found["eta"], 1)


def test_equal_indices_never_reflect() -> None:
    found = sampled(djpt.load_dict({"type": "glass", "int_ior": 1.3, "ext_ior": 1.3}), BOTH, 0.0)
    np.testing.assert_array_equal(found["type"], int(BSDFFlags.DeltaTransmission))
    np.testing.assert_array_equal(found["pdf"], 1)


def test_flags_of_single_lobes() -> None:
    for missing, lobe in (("transmission", BSDFFlags.DeltaReflection), ("reflection", BSDFFlags.DeltaTransmission)):
        assert djpt.load_dict({"type": "glass", missing: False}).flags() & BSDFFlags.Delta == lobe
