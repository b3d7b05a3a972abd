"""The error of images with and without their noise: the table of docs/guides/denoising.md.

    python benchmarks/denoising.py [--size N] [--reference N] [--spp N ..] [--scenes NAME ..]

Each number is that of one image of `--size` pixels to each side, rendered with the box filter, against one of
`--reference` samples per pixel; the gallery's are means over some materials. Each cell has relMSE / FLIP: relMSE is
mean((a - b)^2 / (b^2 + 0.01)), FLIP the mean of the map for displays (P. Andersson et al., *FLIP: A Difference
Evaluator for Alternating Images*, 2020), if flip-evaluator is installed.
"""

from __future__ import annotations

import djpt  # isort: skip (first: it finds the LLVM library that Dr.Jit opens)
import argparse
import importlib.util
from typing import Any

import numpy as np

from djpt.rendering.denoising.filtering import METHODS, Guides, denoise_pixels
from djpt.rendering.denoising.rendered import render_guides
from djpt.rendering.settings import RenderSettings
from djpt.scenes.gallery import panels

SCENES = ("cornell_box", "shader_ball", "stage", "gallery")
GALLERY = ("roughplastic", "bumpmap", "roughconductor", "roughdielectric", "principled", "glass")
"""The materials of the gallery that are rendered."""
COLUMNS = ("raw", "Open Image Denoise", "without guides", "non-local means")


def errors(image: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """relMSE and FLIP of an image; without flip-evaluator, NaN for the latter."""
    difference = float(np.mean(np.square(image - reference) / (np.square(reference) + 1e-2)))
    if importlib.util.find_spec("flip_evaluator") is None:
        return difference, float("nan")
    import flip_evaluator

    shown = [np.ascontiguousarray(np.clip(pixels, 0, 1), np.float32) for pixels in (reference, image)]
    return difference, float(flip_evaluator.evaluate(*shown, "LDR", inputsRGB=False)[1])


def versions(noisy: np.ndarray, guides: Guides) -> list[np.ndarray]:
    """The images of a row, in the order of `COLUMNS`."""
    assert METHODS == ("oidn", "nlm")
    filtered = [("oidn", guides), ("oidn", Guides()), ("nlm", guides)]
    return [noisy, *(denoise_pixels(noisy, known, 3, method) for method, known in filtered)]


def loaded(description: dict[str, Any], size: int) -> Any:
    """A scene with square pixels that share no samples."""
    description["sensor"]["film"].update(width=size, height=size, rfilter={"type": "box"})
    return djpt.load_dict(description)


def scenes_of(name: str, size: int) -> list[Any]:
    """The scenes of a row."""
    if name == "gallery":
        return [loaded(panel.scene(size), size) for panel in panels(GALLERY)]
    return [loaded(djpt.scenes.SCENES[name](), size)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--spp", type=int, nargs="*", default=[4, 16, 64, 256])
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    options = parser.parse_args()
    print(f"| scene | spp | {' | '.join(COLUMNS)} |")
    print("|---|---" + "|---" * len(COLUMNS) + "|")
    for name in options.scenes:
        rows: dict[int, list[list[tuple[float, float]]]] = {spp: [] for spp in options.spp}
        for scene in scenes_of(name, options.size):
            reference = np.array(djpt.render(scene, spp=options.reference, seed=1))[..., :3]
            for spp, row in rows.items():
                noisy = np.array(djpt.render(scene, spp=spp))[..., :3]
                guides = render_guides(scene, RenderSettings.of(scene))
                row.append([errors(image, reference) for image in versions(noisy, guides)])
        for spp, row in rows.items():
            cells = [f"{a:.2g} / {b:.3f}" for a, b in np.mean(row, 0)]
            print(f"| `{name}` | {spp} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
