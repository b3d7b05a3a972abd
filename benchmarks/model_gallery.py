"""Write docs/model-gallery.md and its pictures: ``python benchmarks/model_gallery.py FOLDER [TITLE ..]``.

FOLDER holds copies of the public repositories of `MODELS` by their names, ``git clone --depth 1`` of
``https://github.com/OWNER/NAME`` in FOLDER/NAME. With titles, only these are rendered anew.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "model-gallery.md"
IMAGES = ROOT / "docs" / "images" / "models"
WIDTH = 480
"""The width of the pictures on the page."""

CC_BY = "[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/)"
CC0 = "[CC0](https://creativecommons.org/publicdomain/zero/1.0/)"
APACHE = "[Apache 2.0](https://www.apache.org/licenses/LICENSE-2.0)"
BSD = "[BSD 2-Clause](https://opensource.org/license/bsd-2-clause)"

KHRONOS = "KhronosGroup/glTF-Sample-Assets"
USD = "usd-wg/assets"


@dataclass(frozen=True)
class Entry:
    """A model of the page."""

    title: str
    repository: str
    path: str
    credit: str
    licence: str
    options: str = ""
    """Of the command."""

    @property
    def picture(self) -> str:
        """The name of the picture that the command writes."""
        return f"{self.title.lower().replace(' ', '-')}.png"

    @property
    def command(self) -> str:
        """The line that makes the picture, in the folder of the model."""
        return " ".join(["djpt render", Path(self.path).name, *self.options.split(), "-o", self.picture])


MODELS = (
    Entry("Avocado", KHRONOS, "Models/Avocado/glTF/Avocado.gltf", "Microsoft", CC0),
    Entry("Chair", KHRONOS, "Models/SheenChair/glTF/SheenChair.gltf", "Eric Chadwick, Wayfair", CC0),
    Entry("Shoe", KHRONOS, "Models/MaterialsVariantsShoe/glTF/MaterialsVariantsShoe.gltf", "Shopify", CC_BY),
    Entry(
        *("Sofa", KHRONOS, "Models/GlamVelvetSofa/glTF-Binary/GlamVelvetSofa.glb", "Eric Chadwick, Wayfair", CC_BY),
        options="-D variant=Champagne",
    ),
    Entry(
        *("Fox", KHRONOS, "Models/Fox/glTF-Binary/Fox.glb"),
        *("PixelMannen; rigging by tomkranis; glTF by AsoboStudio and scurest", f"{CC0}, {CC_BY}"),
        options="-D animation=1 -D time=0.3",
    ),
    Entry(
        *("Olives", KHRONOS, "Models/IridescentDishWithOlives/glTF/IridescentDishWithOlives.gltf"),
        *("Eric Chadwick, Wayfair", CC_BY),
    ),
    Entry(
        *("Flowers", KHRONOS, "Models/GlassVaseFlowers/glTF-Binary/GlassVaseFlowers.glb"),
        *("Eric Chadwick, Rico Cilliers", CC0),
    ),
    Entry(
        *("Lamp", KHRONOS, "Models/StainedGlassLamp/glTF/StainedGlassLamp.gltf", "Eric Chadwick, Wayfair", CC_BY),
    ),
    Entry("Suzanne", KHRONOS, "Models/Suzanne/glTF/Suzanne.gltf", "Norbert Nopper, UX3D", CC0),
    Entry(
        *("Teapot", USD, "full_assets/Teapot/Teapot.usd", "ASWF USD Working Group", APACHE),
    ),
    Entry(
        *("Spot", "alecjacobson/common-3d-test-models", "data/spot.obj"),
        *("[Keenan Crane](https://www.cs.cmu.edu/~kmcrane/Projects/ModelRepository/)", CC0),
    ),
    Entry(
        *("Gears", "3MFConsortium/3mf-samples", "examples/core/heartgears.3mf", "3MF Consortium", BSD),
    ),
)


def render(entry: Entry, folder: Path) -> float:
    """Render the picture of a model; the processor time of the command in seconds."""
    where = (folder / entry.repository.split("/")[1] / entry.path).parent
    with tempfile.TemporaryDirectory() as name:
        target = Path(name) / entry.picture
        command = [sys.executable, "-m", "djpt", *shlex.split(entry.command)[1:-1], str(target)]
        # Kernels are compiled for each picture anew.
        environment = os.environ | {"HOME": name, "PYTHONPATH": str(ROOT), "DJPT_TEST_QUICK": ""}
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, cwd=where, env=environment, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        picture = Image.open(target).convert("RGB")
    height = round(WIDTH * picture.height / picture.width)
    IMAGES.mkdir(exist_ok=True)
    picture.resize((WIDTH, height), Image.Resampling.LANCZOS).save(
        (IMAGES / entry.picture).with_suffix(".jpg"), quality=88, optimize=True
    )
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def page(seconds: dict[str, float], processor: str) -> str:
    """The text of the page."""
    lines = [
        "# Models in one line",
        "",
        "Twelve public models, each with the one command that made its picture: camera, sky and ground are those of "
        "[the stage](guides/models.md#the-stage), the pictures 768 x 576 pixels at 64 samples, shown smaller. Below "
        f"each command is its processor time, compilation included, on {processor}; several cores divide it. Then "
        "follow who made the model, and its licence, which is that of the picture, too. "
        "`python benchmarks/model_gallery.py FOLDER` makes the page.",
    ]
    for entry in MODELS:
        address = f"https://github.com/{entry.repository}/tree/HEAD/{Path(entry.path).parent}"
        credit = entry.credit if entry.credit.startswith("[") else f"[{entry.credit}]({address})"
        lines += [
            *("", f"## {entry.title}", ""),
            *(f"![{entry.title}](images/models/{Path(entry.picture).stem}.jpg)", ""),
            *("```text", entry.command, "```", ""),
            f"*{seconds[entry.title]:.0f} s* · {credit}, {entry.licence}",
        ]
    return "\n".join(lines) + "\n"


def processor_name() -> str:
    """The name of this machine's processor, and the widest vectors that it has."""
    try:
        rows = [row.partition(":") for row in Path("/proc/cpuinfo").read_text().splitlines()]
    except OSError:
        return platform.processor() or platform.machine()
    found = {key.strip(): value.strip() for key, _, value in rows}
    vectors = "AVX-512" if "avx512f" in found.get("flags", "") else "AVX2"
    return f"an {found.get('model name', platform.machine())} with {vectors}"


def main() -> None:
    """Render the models, and write the page."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    kept = IMAGES / "seconds.json"
    found = json.loads(kept.read_text()) if kept.exists() else {"processor": processor_name(), "seconds": {}}
    for entry in MODELS:
        if len(sys.argv) == 2 or entry.title in sys.argv[2:]:
            found["seconds"][entry.title] = round(render(entry, Path(sys.argv[1])), 1)
            print(entry.title, found["seconds"][entry.title], flush=True)
            kept.write_text(json.dumps(found, indent=1) + "\n")
    if all(entry.title in found["seconds"] for entry in MODELS):
        PAGE.write_text(page(found["seconds"], found["processor"]))


if __name__ == "__main__":
    main()
