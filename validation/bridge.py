"""The bridge to Mitsuba 3, the ground truth: it renders the same scene description in this process.

Only this module imports Mitsuba, and only when it is used: rendering never needs it.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np
import numpy.typing as npt

from djpt.core.numeric import as_array
from djpt.core.transforms import ScalarTransform3f, as_transform
from djpt.description.plugin import Plugin
from djpt.errors import BackendError, SceneError
from djpt.jit.backends import load_backend, variant
from djpt.models.writing import in_files
from djpt.scenes.overrides import described
from djpt.validation.metrics import ComparisonError

__all__ = ["VERSION", "Renderer", "mitsuba_renderer", "mitsuba_scene", "render_in_mitsuba", "to_mitsuba"]

VERSION = "3.9.1"
"""The release of Mitsuba that is the ground truth; names and conventions change between releases."""

OWN = ("emitter_choice", "unproven_gradients")
"""Parameters of djpt that change the noise of an image, or its derivatives, and nothing else."""

Renderer = Callable[[int, int], npt.NDArray[np.float32]]
"""A function ``renderer(spp, seed)`` that returns linear pixels (H, W, C)."""


def render_in_mitsuba(scene: Mapping[str, Any] | str, spp: int, seed: int = 0) -> npt.NDArray[np.float32]:
    """Render `scene` in Mitsuba: a dict, or the name of a built-in scene. Linear pixels (H, W, C)."""
    return mitsuba_renderer(described(scene)[1])(spp, seed)


def mitsuba_renderer(scene: Mapping[str, Any], optimize: bool = True) -> Renderer:
    """Load `scene` into Mitsuba once, to be rendered many times.

    `optimize`: Mitsuba merges shapes and materials that are alike, its fast default. This doesn't change the image's
    mean, but which emitter a random number chooses, with many meshes even from run to run: pass False, also to
    `djpt.load_dict`, to compare at equal seeds.

    Raises:
        BackendError: Mitsuba isn't installed, or its variant can't be used.
        ComparisonError: Mitsuba refuses the scene.
    """
    with _variant() as mi:
        loaded = _loaded(mi, scene, optimize)

    def render(spp: int, seed: int) -> npt.NDArray[np.float32]:
        with _variant() as mi:
            return np.array(mi.render(loaded, spp=spp, seed=seed), np.float32)

    return render


@contextlib.contextmanager
def mitsuba_scene(scene: Mapping[str, Any] | None) -> Iterator[tuple[Any, Any]]:
    """Mitsuba's module, in djpt's variant, and `scene` loaded into it (None without one).

    Raises:
        BackendError: Mitsuba isn't installed, or its variant can't be used.
        ComparisonError: Mitsuba refuses the scene.
    """
    with _variant() as mi:
        yield mi, None if scene is None else _loaded(mi, scene, optimize=False)


def _loaded(mi: Any, scene: Mapping[str, Any], optimize: bool) -> Any:
    try:
        # Meshes in memory go through files, which Mitsuba reads at once.
        with tempfile.TemporaryDirectory(prefix="djpt-") as folder, _a_second_thread():
            # Several nodes at a time could keep all threads waiting.
            return mi.load_dict(in_files(to_mitsuba(scene), Path(folder)), parallel=False, optimize=optimize)
    except (RuntimeError, TypeError, ValueError) as error:
        raise ComparisonError(f"Mitsuba can't load the scene: {error}") from error


@contextlib.contextmanager
def _a_second_thread() -> Iterator[None]:
    """Let Dr.Jit have two threads or more: who reads an EXR file in Mitsuba waits for what another thread has to do."""
    count = dr.thread_count()
    if count < 2:
        dr.set_thread_count(2)
    try:
        yield
    finally:
        if count < 2:
            dr.set_thread_count(count)


def to_mitsuba(scene: Mapping[str, Any]) -> dict[str, Any]:
    """`scene` with djpt's values replaced by those that Mitsuba's `load_dict` takes.

    Transforms (ours, NumPy 4 x 4, nested lists) become `mitsuba.ScalarTransform4f`; Dr.Jit and NumPy scalars and
    short arrays become Python's. An `envmap`'s `data` becomes a bitmap, a `gridvolume`'s a grid, `sobol` becomes
    `independent`; `emitter_choice` and `unproven_gradients` are left out. The image keeps its mean. Mitsuba's own
    objects stay. `scene` is not modified. Raises `ComparisonError` for djpt's plugin objects, which only djpt can
    render.
    """
    with _variant() as mi:
        return {key: _value(mi, value, f"scene.{key}") for key, value in scene.items()}


def _value(mi: Any, value: Any, node: str) -> Any:
    if isinstance(value, Mapping):
        return {key: _value(mi, inner, f"{node}.{key}") for key, inner in _in_its_words(mi, value).items()}
    if isinstance(value, Plugin):
        raise ComparisonError(
            f"{node}: a {type(value).__name__} object of djpt can't be passed to Mitsuba; describe it with a dict"
        )
    if isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if type(value).__module__ == "mitsuba" and type(value).__name__.startswith("Scalar"):
        return value
    if hasattr(value, "matrix") and not dr.is_array_v(value):
        if np.shape(value.matrix)[:2] == (3, 3):
            return mi.ScalarTransform3f(ScalarTransform3f(value).matrix.tolist())
        return mi.ScalarTransform4f(as_transform(value).matrix.tolist())
    try:
        array = as_array(value)
    except SceneError:
        return value  # an object of Mitsuba, or a value that Mitsuba will refuse with a message
    if array.ndim == 3:
        return value  # pixels
    return mi.ScalarTransform4f(array.tolist()) if array.shape == (4, 4) else array.tolist()


def _in_its_words(mi: Any, node: Mapping[str, Any]) -> dict[str, Any]:
    """Replace what only djpt knows in a node by Mitsuba's terms, where the image keeps its mean."""
    known = {key: value for key, value in node.items() if key not in OWN}
    pixels = known.get("data")
    if known.get("type") == "sobol":
        known = {key: known[key] for key in ("sample_count", "seed") if key in known} | {"type": "independent"}
    elif known.get("type") == "envmap" and pixels is not None:
        del known["data"]
        known["bitmap"] = mi.Bitmap(np.array(pixels, np.float32))
    elif isinstance(known.get("bitmap"), np.ndarray):
        known["bitmap"] = mi.Bitmap(np.ascontiguousarray(known["bitmap"]))
    elif known.get("type") == "gridvolume" and pixels is not None:
        del known["data"]
        known["grid"] = mi.VolumeGrid(np.array(pixels, np.float32))
    elif known.get("type") == "bitmap" and pixels is not None:
        # A copy: Mitsuba takes the memory of tensors that it is given.
        known["data"] = mi.TensorXf(np.array(pixels, np.float32))
    return known


@contextlib.contextmanager
def _variant() -> Iterator[Any]:
    """Use Mitsuba with djpt's variant; a script's own variant is restored afterwards."""
    load_backend()  # so that both use one LLVM, found by djpt
    try:
        import mitsuba as mi
    except ImportError as error:
        raise BackendError(
            f"comparing needs Mitsuba {VERSION}, which can't be imported ({error}): pip install mitsuba=={VERSION}"
        ) from None
    name, before = variant(), mi.variant()
    if name not in mi.variants():
        raise BackendError(f"this Mitsuba has no variant '{name}'; it has {', '.join(mi.variants())}")
    if before != name:
        mi.set_variant(name)
    try:
        yield mi
    finally:
        if before not in (None, name):
            mi.set_variant(before)
