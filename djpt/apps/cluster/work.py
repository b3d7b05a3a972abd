"""The work done by workers: scenes sent with their files, loaded once, rendered in rounds, differentiated."""

from __future__ import annotations

import hashlib
import pickle
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

import djpt
from djpt.core.files import read_bytes, shortened, writing
from djpt.description.files import named_files, with_files
from djpt.errors import BackendError, FileError, SceneError
from djpt.jit.llvm.lanes import lane_count
from djpt.rendering.progressive.rounds import Rounds
from djpt.rendering.settings import RenderSettings
from djpt.scene.scene import Scene
from djpt.version import __version__

__all__ = ["Answer", "Bundle", "differentiated", "distributed", "rendered", "software"]

KEPT = 4
"""The number of scenes that a worker keeps, the most recently used ones."""

one_at_a_time = threading.Lock()
"""Held while something is rendered: Dr.Jit's threads work on one task at a time, whatever threads the worker has."""

# A task is a function and its arguments: what a worker keeps from one to the next can only be kept by its process.

loaded: OrderedDict[str, Scene] = OrderedDict()
"""Those scenes, by the keys of their bundles."""

begun: dict[tuple[str, int, int, str], Rounds] = {}
"""The render whose rounds were computed last."""


def distributed() -> Any:
    """The package `distributed`; raises `BackendError` if it isn't installed."""
    try:
        import distributed
    except ImportError:
        raise BackendError("clusters need the package 'distributed': pip install 'dask[distributed]'") from None
    return distributed


@dataclass(frozen=True)
class Answer:
    """The result of a task, and the software that computed it."""

    value: Any
    software: str


def software() -> str:
    """Everything that the bits of a result depend on: versions, and the vector width."""
    return f"djpt {__version__}, drjit {version('drjit')}, {lane_count()} lanes"


def scene_of(bundle: Bundle) -> Scene:
    """The scene of a bundle, loaded on first use."""
    if bundle.key not in loaded:
        loaded[bundle.key] = bundle.loaded()
    loaded.move_to_end(bundle.key)
    while len(loaded) > KEPT:
        loaded.popitem(last=False)
    return loaded[bundle.key]


def rendered(bundle: Bundle, sensor: int, spp: int, schedule: str, seed: int) -> Answer:
    """A round of a render: see `djpt.rendering.progressive.rounds`."""
    with one_at_a_time:
        scene = scene_of(bundle)
        key = bundle.key, sensor, spp, schedule
        if key not in begun:
            begun.clear()
            begun[key] = Rounds(scene, RenderSettings.of(scene, sensor, spp=spp, schedule=schedule))
        return Answer(begun[key].begin(seed)(), software())


def differentiated(
    bundle: Bundle,
    values: Mapping[str, npt.NDArray[np.floating]],
    loss: Callable[[Any, int], Any],
    view: int,
    spp: int,
    seed: int,
) -> Answer:
    """The loss of one view, and its derivatives with respect to the parameters: (float, arrays by name)."""
    with one_at_a_time:
        scene = scene_of(bundle)
        params = djpt.traverse(scene)
        before = {key: type(params[key])(params[key]) for key in values}
        try:
            for key, value in values.items():
                params[key] = type(params[key])(value)
                dr.enable_grad(params[key])
            params.update()
            result = loss(djpt.render(scene, params, sensor=view, spp=spp, seed=seed), view)
            dr.backward(result)
            derivatives = {key: np.array(dr.grad(params[key])) for key in values}
            return Answer((float(np.array(dr.detach(result)).ravel()[0]), derivatives), software())
        finally:
            # The next task finds the scene as it was loaded.
            params.update({key: dr.detach(value) for key, value in before.items()})


# ---- a scene together with its files ---------------------------------------------------------


@dataclass(frozen=True)
class Bundle:
    """A description and the contents of the files that it names."""

    key: str
    """A hash of the description and the files."""
    description: bytes
    """The description, pickled: workers trust whoever sends them tasks, as `dask.distributed` requires."""
    files: Mapping[str, tuple[str, bytes]]
    """By the name in the description: the file's name here, a hash with its extension, and its contents."""

    @classmethod
    def of(cls, description: Mapping[str, Any]) -> Bundle:
        """Pack a description.

        Raises:
            SceneError: It holds objects that can't be sent, such as plugins that are already loaded.
            FileError: A file can't be read.
        """
        try:
            packed = pickle.dumps(description)
        except Exception as error:  # whatever an object raises that can't be pickled
            raise SceneError(f"the scene can't be sent to workers: {error}; describe it as a dict or a file") from None
        files = {}
        for name, path in named_files(description).items():
            contents = read_bytes(path)
            files[name] = (named(contents, path.suffix), contents)
        total = hashlib.blake2b(packed, digest_size=16)
        for name, (stored, _) in sorted(files.items()):
            total.update(f"{name}\0{stored}\0".encode())
        return cls(total.hexdigest(), packed, files)

    def loaded(self) -> Scene:
        """The scene.

        Its files are written into a new folder that only this user can access, and are deleted once they are read.

        Raises:
            FileError: The contents of a file differ from those that were packed, or can't be written.
            SceneError: The scene is wrong.
        """
        with tempfile.TemporaryDirectory(prefix="djpt-cluster-", ignore_cleanup_errors=True) as folder:
            return djpt.load_dict(self.unpacked(Path(folder)))

    def unpacked(self, folder: Path) -> dict[str, Any]:
        """The description, naming files that are written into a folder.

        Raises:
            FileError: The contents of a file differ from those that were packed, or can't be written.
        """
        places = {}
        for name, (stored, contents) in self.files.items():
            if stored != named(contents, Path(name).suffix):
                raise FileError(f"'{shortened(name)}' was corrupted in transit: its contents don't match their hash")
            with writing(folder / stored) as temporary:
                temporary.write_bytes(contents)
            places[name] = str(folder / stored)
        return with_files(pickle.loads(self.description), places)


def named(contents: bytes, suffix: str) -> str:
    """The name of a file that has some contents: their hash, and an extension."""
    return hashlib.blake2b(contents, digest_size=16).hexdigest() + suffix
