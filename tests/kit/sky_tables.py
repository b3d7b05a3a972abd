"""The tables of `djpt/emitters/sky/hosek_wilkie.npz`, made from the files that come with Mitsuba.

    python -m tests.kit.sky_tables djpt/emitters/sky/hosek_wilkie.npz

writes them anew.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import djpt  # noqa: F401  before Mitsuba

__all__ = ["tables_of_mitsuba"]

WAVELENGTHS = np.arange(320, 721, 40, dtype=np.float32)
"""Those of the model's spectra, in nm."""


def tables_of_mitsuba() -> dict[str, Any]:
    """All tables by name, float32; the first axes are named in `djpt.emitters.sky.tables`."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    folder = Path(mi.__file__).parent / "data" / "sunsky"
    model, sampling = (mi.tensor_io.read(folder / f"{name}.bin") for name in ("sunsky_datasets", "sampling_data"))

    # Averages over the wavelengths with the weights of the eye, in the units that Mitsuba's colours have.
    xyz = np.array(mi.cie1931_xyz(mi.Float(WAVELENGTHS)), np.float64)
    to_rgb = np.array(
        [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
    )
    count = len(WAVELENGTHS)
    sun, sky = sampling["sun_irradiance"], sampling["sky_irradiance"]
    tables = {
        "sky": np.concatenate(
            [np.moveaxis(model["sky_params_rgb"], -1, -2), model["sky_rad_rgb"][..., None, :]], axis=-2
        ),
        "sun": model["sun_rad_rgb"].reshape(10, 45, 18, 4),
        "irradiance": np.concatenate(
            [sun @ (to_rgb @ xyz).T / count, (sun @ xyz[1:2].T) / count, (sky @ xyz[1:2].T) / count], axis=-1
        ),
        "density": sampling["weights"],
    }
    return {name: table.astype(np.float32) for name, table in tables.items()}


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **tables_of_mitsuba())
