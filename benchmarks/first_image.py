"""Seconds from the end of the imports to the first image: ``python first_image.py djpt|mitsuba FILTER|FILE.ply``.

The Cornell box with a filter, or a mesh over a floor. Run by `versus_mitsuba.py` and `meshes.py`, in a process of its
own with an empty kernel cache. The clock starts when Dr.Jit and the renderer are imported and the variant is set; it
runs while the scene is loaded, traced, compiled and rendered, and stops when the image is finished.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

SPP = 16


def first_image(renderer: Any, description: dict[str, Any]) -> float:
    """The seconds that loading and rendering take, until the image is computed."""
    import drjit as dr

    start = time.perf_counter()
    image = renderer.render(renderer.load_dict(description), spp=SPP)
    dr.eval(image)
    dr.sync_thread()
    return time.perf_counter() - start


def main() -> None:
    """Print the seconds."""
    import djpt

    if sys.argv[1] == "mitsuba":
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
        renderer: Any = mitsuba
    else:
        # Names of djpt are imported at their first use; Mitsuba's with the variant.
        renderer = djpt
        _ = djpt.load_dict, djpt.render, djpt.integrators
    if sys.argv[2].endswith(".ply"):
        from mesh_scenes import bumpy_sphere, over_floor

        description = over_floor(renderer, bumpy_sphere(Path(sys.argv[2]), True))
    else:
        description = renderer.cornell_box()
        description["sensor"]["film"]["rfilter"] = {"type": sys.argv[2]}
    print(first_image(renderer, description))


if __name__ == "__main__":
    main()
