"""Small valid files of all formats that djpt reads, and a line of Python that reads each."""

from __future__ import annotations

import functools
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import djpt
from djpt.description.tensor_files import write_tensors
from tests.fuzz.models import gltf_model
from tests.kit.meshes import bumpy_sheet, properties, write_binary_ply, write_obj, write_ply, write_serialized
from tests.kit.photographs import bundle, calibration, colmap_binary, colmap_text, transforms

__all__ = ["READERS", "seed_files"]

SHOWN = (
    "image = djpt.render(djpt.load_dict({{'type': 'scene', 'integrator': {{'type': 'depth'}}, 'shape': {node}, "
    "'sensor': {{'type': 'perspective', 'film': {{'type': 'hdrfilm', 'width': 4, 'height': 4}}}}}}), spp=1)"
)
"""A scene with a shape, rendered: what was read is also intersected."""


def mesh(kind: str, name: str) -> str:
    """Read a mesh and render it."""
    return SHOWN.format(node={"type": kind, "filename": name})


def loaded(kind: str, name: str, **entries: Any) -> str:
    """Load a plugin of a file."""
    return f"djpt.load_dict({ {'type': kind, 'filename': name, **entries}!r})"


def cameras(*names: str) -> str:
    """Read the cameras of photographs, and make the sensors."""
    return (
        f"for name in {names!r}:\n"
        "    cameras = djpt.load_cameras(name, size=(8, 6) if name == 'bundle.out' else None)\n"
        "    djpt.load_dict({'type': 'scene', **cameras.sensors()})"
    )


READERS: dict[str, tuple[str, ...]] = {
    "a.obj": (mesh("obj", "a.obj"),),
    "text.ply": (mesh("ply", "text.ply"), loaded("ellipsoids", "text.ply")),
    "a.ply": (mesh("ply", "a.ply"), loaded("ellipsoids", "a.ply")),
    "big.ply": (mesh("ply", "big.ply"),),
    "cloud.ply": (loaded("ellipsoids", "cloud.ply"), loaded("ellipsoidsmesh", "cloud.ply")),
    "a.serialized": (mesh("serialized", "a.serialized"), loaded("serialized", "a.serialized", shape_index=1)),
    "a.vol": (loaded("gridvolume", "a.vol"), mesh("sdfgrid", "a.vol"), "djpt.VolumeGrid('a.vol')"),
    "a.bsdf": (loaded("measured", "a.bsdf"), "djpt.TensorFile('a.bsdf')", "djpt.tensor_io.read('a.bsdf')"),
    "a.txt": (loaded("linearcurve", "a.txt"), loaded("bsplinecurve", "a.txt")),
    "a.spd": (loaded("spectrum", "a.spd"), "djpt.spectrum_from_file('a.spd')"),
    "m.glb": ("djpt.load_file('m.glb', trusted=False)", "djpt.load_file('m.glb', time=0.5)"),
    "m.gltf": ("djpt.load_file('m.gltf', trusted=False)", "djpt.load_file('m.gltf', time=0.5)"),
    **dict.fromkeys(("cameras.txt", "images.txt"), (cameras("cameras.txt", "images.txt"),)),
    **dict.fromkeys(("cameras.bin", "images.bin"), (cameras("cameras.bin", "images.bin"),)),
    **{name: (cameras(name),) for name in ("transforms.json", "bundle.out", "camera.yml")},
    "a.xml": ("djpt.load_file('a.xml')", "djpt.load_file('a.xml', trusted=False)"),
    **{
        f"a.{suffix}": (
            loaded("bitmap", f"a.{suffix}"),
            loaded("envmap", f"a.{suffix}"),
            f"djpt.read('a.{suffix}')",
            f"djpt.Bitmap('a.{suffix}')",
            f"djpt.read_metadata('a.{suffix}')",
        )
        for suffix in ("exr", "hdr", "pfm", "npy", "png", "jpg", "bmp", "tga", "ppm", "tif")
    },
}
"""Programs that read a file, by its name."""

SCENE = """<scene version="3.0.0">
    <default name="width" value="4"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 0, -4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="$width"/><rfilter type="box"/></film>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.5 0.5 0.5"/></bsdf>
    <shape type="sphere"><point name="center" x="0" y="1" z="0"/><ref id="white"/></shape>
    <shape type="rectangle"><boolean name="flip_normals" value="true"/>
        <emitter type="area"><spectrum name="radiance" value="400:1, 700:2"/></emitter></shape>
    <alias id="white" as="pale"/>
</scene>
"""

CURVES = """0 0 3 0.1
1 1 3 0.1
2 4 3 0.1
3 9 3 0.1

0 0 4 .2
1 0 4 .2
1 1 4 .2
2 1 4 .2
"""


@functools.cache
def seed_files() -> dict[str, bytes]:
    """The contents of the files of `READERS`, by name."""
    with tempfile.TemporaryDirectory(prefix="djpt-") as folder:
        make(Path(folder))
        return {name: (Path(folder) / name).read_bytes() for name in READERS}


def make(folder: Path) -> None:
    """Write all files to a folder."""
    sheet = bumpy_sheet(3)
    write_obj(folder / "a.obj", sheet)
    write_ply(folder / "text.ply", "0 0 3\n1 0 3\n0 1 3\n1 1 3", "3 0 1 2\n4 0 1 3 2")
    write_binary_ply(folder / "a.ply", sheet)
    write_binary_ply(folder / "big.ply", sheet, ">", uv=False)
    cloud(folder / "cloud.ply")
    write_serialized(folder / "a.serialized", [sheet, sheet])
    corners = np.stack(np.indices((4, 4, 4)), axis=-1) - 1.5
    djpt.VolumeGrid((np.linalg.norm(corners, axis=-1) - 1).astype(np.float32)[..., None]).write(folder / "a.vol")
    tables(folder / "a.bsdf")
    (folder / "a.txt").write_text(
        "".join(f"{x} {x * x} 3 0.1\n" for x in range(5)) + "\n0 0 4 .2\n1 0 4 .2\n1 1 4 .2\n2 1 4 .2\n"
    )
    (folder / "a.spd").write_text("# wavelength, value\n400 0.5\n500 1.5\n700 0.25\n")
    (folder / "a.xml").write_text(SCENE)
    for name, content in {**colmap_text(), **colmap_binary(), "bundle.out": bundle()}.items():
        (folder / name).write_bytes(content)
    (folder / "transforms.json").write_text(json.dumps(transforms(k1=-0.1)))
    (folder / "camera.yml").write_text(calibration())
    file = gltf_model()
    (folder / "m.glb").write_bytes(file.glb())
    (folder / "m.gltf").write_bytes(file.gltf())
    rng = np.random.default_rng(0)
    for name in READERS:
        if name.split(".")[1] in ("exr", "hdr", "pfm", "npy", "png", "jpg", "bmp", "tga", "ppm", "tif"):
            djpt.write(folder / name, rng.random((6, 8, 3), dtype=np.float32))


def cloud(path: Path) -> None:
    """A file of three ellipsoids, as of Gaussian splatting."""
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    rows = np.random.default_rng(1).random((3, len(names)), dtype=np.float32)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 3\n{properties(*names)}end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())


def tables(path: Path) -> None:
    """A file of a measured material with few numbers."""
    rng = np.random.default_rng(2)
    shapes = {"ndf": (4, 4), "sigma": (4, 4), "vndf": (1, 3, 4, 4), "luminance": (1, 3, 4, 4), "rgb": (1, 3, 3, 4, 4)}
    numbers = {"theta_i": np.linspace(0, 1.5, 3), "phi_i": np.zeros(1)}
    numbers |= {name: rng.random(shape) for name, shape in shapes.items()}
    tensors = {name: value.astype(np.float32) for name, value in numbers.items()}
    write_tensors(path, {**tensors, "jacobian": np.array([1], np.uint8), "description": "made for tests"})
