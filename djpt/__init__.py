"""djpt: a differentiable path tracer in pure Python over Dr.Jit.

    import djpt

    scene = djpt.load_dict(djpt.cornell_box())
    image = djpt.render(scene, spp=64)
    djpt.write("cornell_box.png", image)

Names that Mitsuba 3 has as well mean the same here. ``import djpt`` is light: a name is
imported when it is first used, and Dr.Jit with the first name that needs it. Until then
`set_variant` can choose the backend.
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

from djpt.core.former_paths import FormerPaths as _FormerPaths
from djpt.core.garbage import without_garbage as _without_garbage
from djpt.core.lazy import lazily as _lazily
from djpt.jit.llvm.finder import prepare as _prepare
from djpt.mitsuba.names import EXPORTS as _FOR_SCRIPTS
from djpt.mitsuba.names import SUBMODULES as _MODULES_FOR_SCRIPTS
from djpt.mitsuba.names import VARIANT_MODULES as _VARIANT_MODULES
from djpt.version import __version__ as __version__

if TYPE_CHECKING:
    from djpt import errors as errors
    from djpt import integrators as integrators
    from djpt import materials as materials
    from djpt import scenes as scenes
    from djpt import validation as validation
    from djpt.apps import optimization as optimization
    from djpt.apps.display import show_passes as show_passes
    from djpt.apps.optimization.loop import optimize as optimize
    from djpt.apps.show import show as show
    from djpt.core import warp as warp
    from djpt.core.bounding_box import BoundingBox2f as BoundingBox2f
    from djpt.core.bounding_box import BoundingBox3f as BoundingBox3f
    from djpt.core.bounding_box import BoundingSphere3f as BoundingSphere3f
    from djpt.core.bounding_box import ScalarBoundingBox2f as ScalarBoundingBox2f
    from djpt.core.bounding_box import ScalarBoundingBox3f as ScalarBoundingBox3f
    from djpt.core.bounding_box import ScalarBoundingSphere3f as ScalarBoundingSphere3f
    from djpt.core.frame import Frame3f as Frame3f
    from djpt.core.frame import coordinate_system as coordinate_system
    from djpt.core.interruption import Terminated as Terminated
    from djpt.core.records import BSDFContext as BSDFContext
    from djpt.core.records import BSDFFlags as BSDFFlags
    from djpt.core.records import BSDFSample3f as BSDFSample3f
    from djpt.core.records import DirectionSample3f as DirectionSample3f
    from djpt.core.records import EmitterFlags as EmitterFlags
    from djpt.core.records import Interaction3f as Interaction3f
    from djpt.core.records import PositionSample3f as PositionSample3f
    from djpt.core.records import PreliminaryIntersection3f as PreliminaryIntersection3f
    from djpt.core.records import Ray3f as Ray3f
    from djpt.core.records import RayFlags as RayFlags
    from djpt.core.records import SurfaceInteraction3f as SurfaceInteraction3f
    from djpt.core.records import TransportMode as TransportMode
    from djpt.core.records import has_flag as has_flag
    from djpt.core.transforms import ScalarTransform3f as ScalarTransform3f
    from djpt.core.transforms import ScalarTransform4f as ScalarTransform4f
    from djpt.core.transforms.lanes import AffineTransform3f as AffineTransform3f
    from djpt.core.transforms.lanes import AffineTransform4f as AffineTransform4f
    from djpt.core.transforms.lanes import Transform3f as Transform3f
    from djpt.core.transforms.lanes import Transform4f as Transform4f
    from djpt.description.animation import AnimatedTransform4f as AnimatedTransform4f
    from djpt.description.loader import load_dict as load_dict
    from djpt.description.loader import load_string as load_string
    from djpt.description.parameters import SceneParameters as SceneParameters
    from djpt.description.parameters import traverse as traverse
    from djpt.description.plugin import ParamFlags as ParamFlags
    from djpt.description.plugin import Plugin as Plugin
    from djpt.description.properties import Properties as Properties
    from djpt.description.registry import register_bsdf as register_bsdf
    from djpt.description.registry import register_emitter as register_emitter
    from djpt.description.registry import register_film as register_film
    from djpt.description.registry import register_integrator as register_integrator
    from djpt.description.registry import register_medium as register_medium
    from djpt.description.registry import register_phase as register_phase
    from djpt.description.registry import register_rfilter as register_rfilter
    from djpt.description.registry import register_sampler as register_sampler
    from djpt.description.registry import register_sensor as register_sensor
    from djpt.description.registry import register_shape as register_shape
    from djpt.description.registry import register_texture as register_texture
    from djpt.description.registry import register_volume as register_volume
    from djpt.description.xml.writer import to_xml as to_xml
    from djpt.emitters import Emitter as Emitter
    from djpt.emitters.pointer import EmitterPtr as EmitterPtr
    from djpt.errors import AmbiguityError as AmbiguityError
    from djpt.errors import BackendError as BackendError
    from djpt.errors import DjptError as DjptError
    from djpt.errors import FileError as FileError
    from djpt.errors import ParameterError as ParameterError
    from djpt.errors import RenderError as RenderError
    from djpt.errors import SceneError as SceneError
    from djpt.images.image import Image as Image
    from djpt.images.image import read as read
    from djpt.images.image import read_metadata as read_metadata
    from djpt.images.image import write as write
    from djpt.images.tone_mapping import tonemap as tonemap
    from djpt.integrators import Integrator as Integrator
    from djpt.integrators.moment import variance as variance
    from djpt.jit import types as types
    from djpt.jit.backends import set_variant as set_variant
    from djpt.jit.backends import variant as variant
    from djpt.jit.backends import variants as variants
    from djpt.jit.types import PCG32 as PCG32
    from djpt.jit.types import Bool as Bool
    from djpt.jit.types import Color3f as Color3f
    from djpt.jit.types import Float as Float
    from djpt.jit.types import Float64 as Float64
    from djpt.jit.types import Int as Int
    from djpt.jit.types import Int32 as Int32
    from djpt.jit.types import Mask as Mask
    from djpt.jit.types import Matrix4f as Matrix4f
    from djpt.jit.types import Normal3f as Normal3f
    from djpt.jit.types import Point2f as Point2f
    from djpt.jit.types import Point3f as Point3f
    from djpt.jit.types import Spectrum as Spectrum
    from djpt.jit.types import TensorXf as TensorXf
    from djpt.jit.types import UInt as UInt
    from djpt.jit.types import UInt32 as UInt32
    from djpt.jit.types import UInt64 as UInt64
    from djpt.jit.types import Vector2f as Vector2f
    from djpt.jit.types import Vector3f as Vector3f
    from djpt.materials import BSDF as BSDF
    from djpt.materials.pointer import BSDFPtr as BSDFPtr
    from djpt.media.translucent import subsurface as subsurface
    from djpt.mitsuba import ad as ad
    from djpt.mitsuba import util as util
    from djpt.mitsuba import xml as xml
    from djpt.models.formats import load_file as load_file
    from djpt.models.objects import scene_of as scene_of
    from djpt.models.writing import write_dict as write_dict
    from djpt.photographs.formats import load_cameras as load_cameras
    from djpt.rendering.denoising.filtering import denoise as denoise
    from djpt.rendering.image import channel_names as channel_names
    from djpt.rendering.progressive.accumulation import Accumulation as Accumulation
    from djpt.rendering.progressive.passes import render_passes as render_passes
    from djpt.rendering.progressive.to_file import render_to_file as render_to_file
    from djpt.rendering.render import render as render
    from djpt.scene.scene import Scene as Scene
    from djpt.scenes.cornell import cornell_box as cornell_box
    from djpt.sensors.pointer import SensorPtr as SensorPtr
    from djpt.shapes import Mesh as Mesh
    from djpt.shapes.base import Shape as Shape
    from djpt.shapes.mitsuba_api import ShapeType as ShapeType
    from djpt.shapes.pointer import ShapePtr as ShapePtr
    from djpt.validation.nonfinite import NonFinite as NonFinite
    from djpt.validation.nonfinite import find_nan as find_nan


_SUBMODULES = _MODULES_FOR_SCRIPTS

_own_name, _, _own_names = _lazily(__name__)

_MODULE_OF = {
    name: module for module, names in _FOR_SCRIPTS.items() for name in names.split() if name not in _own_names
}

__all__ = sorted([*_own_names, *_MODULE_OF, *_SUBMODULES, "__version__"])

# The variant is chosen for the process: Mitsuba's modules of one variant are this module.
sys.modules.update({f"djpt.{name}": sys.modules[__name__] for name in _VARIANT_MODULES})

sys.meta_path.insert(0, _FormerPaths())

# NumPy's OpenBLAS starts a thread per core, and each spins for 2^26 ticks until it sleeps, also after each product of
# large matrices: 25 ms of every core, when scenes are loaded and kernels compiled. 2^20 ticks are enough for the next.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "20")

# Before anything can import Dr.Jit, also the user's own `import mitsuba` on the next line.
_prepare()

if "IPython" in sys.modules:
    from djpt.apps.display import show_images

    show_images()


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name in _VARIANT_MODULES:
        return sys.modules[__name__]
    with _without_garbage():
        if name in _SUBMODULES:
            return importlib.import_module(_SUBMODULES[name])
        if name in _own_names:
            value = _own_name(name)
        elif name in _MODULE_OF:
            value = getattr(importlib.import_module(_MODULE_OF[name]), name)
        else:
            raise AttributeError(f"module 'djpt' has no attribute {name!r}{_hint(name)}")
    globals()[name] = value
    return value


def _hint(name: str) -> str:
    """Why Mitsuba's name is left out, or which name is like it."""
    if name.startswith(("_", "DRJIT_")):  # protocols that others look for, Dr.Jit in each call of a frozen function
        return ""
    from djpt.mitsuba.names import reason

    why = reason(name)
    if why:
        return f", which is left out: {why}"
    from djpt.errors import nearest

    close = nearest(name, __all__)
    return f"; did you mean {close!r}?" if close else ""


def __dir__() -> list[str]:
    return __all__
