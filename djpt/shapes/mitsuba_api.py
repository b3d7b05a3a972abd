"""Queries of single shapes by scripts: kind, nested plugins, extent, and rays traced against the shape alone."""

from __future__ import annotations

import copy
import enum
import weakref
from collections.abc import Sequence
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from djpt.core.bounding_box import ScalarBoundingBox3f
from djpt.core.records import (
    DirectionSample3f,
    Observer,
    PositionSample3f,
    PreliminaryIntersection3f,
    Ray3f,
    RayFlags,
    SurfaceInteraction3f,
)
from djpt.description.plugin import ParamFlags, Plugin, TraversalCallback
from djpt.description.properties import Properties
from djpt.description.registry import lookup
from djpt.errors import RenderError, SceneError, near_miss
from djpt.jit.types import ArrayXf, Bool, Color3f, Float, Point2f, UInt32
from djpt.shapes.silhouettes.mitsuba_api import SilhouetteQuestions

__all__ = ["ShapeQuestions", "ShapeType", "TextureAttributes"]


class TextureAttributes(Plugin):
    """The part of a shape that answers for its attributes: textures of any name, and what meshes hold.

    A texture that is nested in a shape is an attribute, whatever its key. The renderer doesn't look at it.
    """

    _textures: dict[str, Any]

    def take_textures(self, props: Properties) -> None:
        """Take the textures that are nested in the shape."""
        self._textures = dict(props.children("texture"))

    def report_textures(self, callback: TraversalCallback) -> None:
        """Report the textures as nested plugins, for `traverse`."""
        for name, texture in self.textures().items():
            callback.put(name, texture, ParamFlags.Differentiable)

    def textures(self) -> dict[str, Any]:
        """The textures by name."""
        return self.__dict__.get("_textures", {})

    def add_texture_attribute(self, name: str, texture: Any) -> None:
        """Give the shape a texture, in place of one of the same name.

        Raises:
            SceneError: it is no texture.
        """
        if getattr(texture, "kind", None) != "texture":
            raise SceneError(f"{self.id()}.{name}: a texture is expected, found {type(texture).__name__}")
        self._textures = {**self.textures(), name: texture}

    def texture_attribute(self, name: str) -> Any:
        """The texture of that name; raises `SceneError` if there is none."""
        if name not in self.textures():
            raise SceneError(f"{self.id()}: there is no texture '{name}'{near_miss(name, self.textures())}")
        return self.textures()[name]

    def remove_attribute(self, name: str) -> None:
        """Take the texture of that name from the shape; raises `SceneError` if there is none."""
        self.texture_attribute(name)
        self._textures = {key: texture for key, texture in self.textures().items() if key != name}

    # ---- questions ----------------------------------------------------------------------------

    def has_attribute(self, name: str, active: Bool | bool = True) -> bool:
        """Whether the shape has a texture, or values at its vertices or faces, of that name."""
        return name in self.textures() or name in getattr(self, "attributes", {})

    def eval_attribute(self, name: str, si: Any, active: Bool | bool = True) -> Color3f:
        """An attribute with one or three channels as a colour, at a point of the shape in a scene."""
        texture = self.textures().get(name)
        return Color3f(self._attribute(name, si, active)) if texture is None else texture.eval(si, active)

    def eval_attribute_1(self, name: str, si: Any, active: Bool | bool = True) -> Float:
        """An attribute with one channel, at a point of the shape in a scene; of a texture `eval_1`."""
        texture = self.textures().get(name)
        return Float(self._attribute(name, si, active)) if texture is None else texture.eval_1(si, active)

    def eval_attribute_3(self, name: str, si: Any, active: Bool | bool = True) -> Color3f:
        """`eval_attribute`: colours have three channels."""
        return self.eval_attribute(name, si, active)

    def eval_attribute_x(self, name: str, si: Any, active: Bool | bool = True) -> ArrayXf:
        """The channels of an attribute, at a point of the shape in a scene."""
        texture = self.textures().get(name)
        value: Any = self._attribute(name, si, active) if texture is None else texture.eval(si, active)
        return ArrayXf([value] if dr.depth_v(value) == 1 else list(value))

    def _attribute(self, name: str, si: Any, active: Bool | bool) -> Any:
        if not self.has_attribute(name):
            hint = near_miss(name, [*self.textures(), *getattr(self, "attributes", {})])
            raise SceneError(f"{self.id()}: there is no attribute '{name}'{hint}")
        return si.scene.geometry.attribute(name, si.face, si.prim_uv, active)


class ShapeType(enum.IntFlag):
    """The kinds of shapes; the values are Mitsuba's. djpt's own shapes are `Other`."""

    Invalid = 0
    Mesh = 1
    Rectangle = 3
    BSplineCurve = 4
    LinearCurve = 8
    Cylinder = 16
    Disk = 32
    SDFGrid = 64
    Sphere = 128
    Ellipsoids = 256
    EllipsoidsMesh = 513
    Other = 1024


class ShapeQuestions(TextureAttributes, SilhouetteQuestions):
    """The part of a shape that kernels don't see.

    A shape that stands in no scene is intersected in one of its own, made of a copy of it.
    """

    shape_kind: ClassVar[ShapeType] = ShapeType.Other
    triangle_count: ClassVar[int] = 1
    """The number of primitives, as Mitsuba counts."""

    _bsdf: Any = None
    _emitter: Any = None
    _sensor: Any = None
    _interior: Any = None
    _exterior: Any = None
    users: Sequence[weakref.ref[Any]] = ()
    """The scenes that contain the shape."""
    original: Any = None
    """The shape that this one was copied from, to be asked alone; else None."""

    # ---- what belongs to it ---------------------------------------------------------------

    def bsdf(self) -> Any:
        """The BSDF; a shape without one gets a diffuse one, grey 0.5, or black if the shape emits."""
        if self._bsdf is None:
            grey = 0.5 if self._emitter is None else 0.0
            self._bsdf = lookup("bsdf", "diffuse")(Properties("diffuse", f"{self.id()}.bsdf", {"reflectance": grey}))
        return self._bsdf

    def set_bsdf(self, bsdf: Any) -> None:
        """Give the shape another BSDF, also in the scenes that it stands in.

        Raises:
            TypeError: It is no BSDF.
        """
        if getattr(bsdf, "kind", None) != "bsdf":
            raise TypeError(
                f"set_bsdf(): incompatible function arguments: expected a BSDF, found {type(bsdf).__name__}"
            )
        self._bsdf = bsdf
        self.forget_alone()
        for user in self.users:
            scene = user()
            if scene is not None:
                scene.renew_bsdfs()

    def emitter(self) -> Any:
        """The area light, or None."""
        return self._emitter

    def sensor(self) -> Any:
        """The sensor, or None."""
        return self._sensor

    def is_emitter(self) -> bool:
        """Whether the shape shines."""
        return self._emitter is not None

    def is_sensor(self) -> bool:
        """Whether the shape carries a sensor."""
        return self._sensor is not None

    def is_mesh(self) -> bool:
        """Whether the shape consists of triangles in memory."""
        return bool(self.shape_type() & ShapeType.Mesh)

    def is_ellipsoids(self) -> bool:
        """False: there are no ellipsoids."""
        return False

    def is_medium_transition(self) -> bool:
        """Whether the surface bounds a medium: one was given, as `interior` or `exterior`."""
        return self._interior is not None or self._exterior is not None

    def interior_medium(self) -> Any:
        """The medium inside, or None. (Absorption in glass belongs to its BSDF.)"""
        return self._interior

    def exterior_medium(self) -> Any:
        """The medium outside, or None."""
        return self._exterior

    def shape_type(self) -> ShapeType:
        """The kind of the shape, with Mitsuba's number."""
        return self.shape_kind

    def has_flipped_normals(self) -> bool:
        """Whether `flip_normals` is set."""
        return bool(getattr(self, "flip_normals", False))

    # ---- extent ---------------------------------------------------------------------------

    def primitive_count(self) -> int:
        """The number of primitives."""
        return self.triangle_count

    def effective_primitive_count(self) -> int:
        """The number of primitives, with those of instances counted each time."""
        return self.primitive_count()

    def bbox(self, index: int | None = None, clip: Any = None) -> ScalarBoundingBox3f:
        """The box about the shape in world space, or about primitive number `index`, cut by the box `clip`.

        That of a shape that moves holds it at all times.
        """
        low, high = self._box(index)
        if self.motion is not None:
            low, high = self.motion.keyframes.box(low, high)
        if clip is not None:
            low, high = np.maximum(low, np.array(clip.min).ravel()), np.minimum(high, np.array(clip.max).ravel())
        return ScalarBoundingBox3f(low, high)

    def _box(self, index: int | None) -> tuple[Any, Any]:
        if index is not None and not 0 <= index < self.primitive_count():
            raise SceneError(f"{self.id()}: there are {self.primitive_count()} primitives, found the index {index}")
        found: tuple[Any, Any] = self.world_box()  # type: ignore[attr-defined]
        return found

    # ---- rays -----------------------------------------------------------------------------

    def ray_intersect(
        self, ray: Ray3f, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The first point of this shape alone with 0 < t < maxt: see `djpt.Scene.ray_intersect`."""
        return self.alone().ray_intersect(ray, ray_flags, False, active=active)

    def ray_intersect_preliminary(
        self, ray: Ray3f, prim_index: int = 0, active: Bool | bool = True
    ) -> PreliminaryIntersection3f:
        """The first hit of this shape alone, on any of its primitives."""
        return self.alone().ray_intersect_preliminary(ray, active=active)

    def ray_test(self, ray: Ray3f, active: Bool | bool = True) -> Bool:
        """True where the shape is hit with 0 < t < maxt."""
        return self.alone().ray_test(ray, active)

    def compute_surface_interaction(
        self, ray: Ray3f, pi: PreliminaryIntersection3f, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point of a hit: see `PreliminaryIntersection3f.compute_surface_interaction`."""
        return pi.compute_surface_interaction(ray, ray_flags, active)

    def eval_parameterization(
        self, uv: Any, ray_flags: int = RayFlags.All, active: Bool | bool = True
    ) -> SurfaceInteraction3f:
        """The surface point with the texture coordinates (u, v) in the unit square; `t` is 0.

        Raises:
            SceneError: The shape has no parameterisation, so that no uv belong to a single point.
        """
        if not self.has_parameterization:  # type: ignore[attr-defined]
            raise SceneError(f"{self.id()}: texture coordinates don't determine a point of this shape")
        self._require_still()
        ps = self.at_uv(Point2f(uv))  # type: ignore[attr-defined]
        si = self.alone().revisit(ps.p, -ps.n, UInt32(0))
        si.t = dr.select(active, Float(0), dr.inf)
        return si

    def sample_position(self, time: Any, sample: Any, active: Bool | bool = True) -> PositionSample3f:
        """Sample a point uniformly by area: pdf = 1 / area. The `time` is just noted.

        Raises:
            RenderError: The shape moves.
        """
        self._require_still()
        ps: PositionSample3f = self.draw_point(Point2f(sample))  # type: ignore[attr-defined]
        ps.time = time
        return ps

    def sample_direction(self, it: Observer, sample: Any, active: Bool | bool = True) -> DirectionSample3f:
        """Sample a point of the shape as seen from `it`; the pdf is per unit solid angle there."""
        self._require_still()
        return self.draw_direction(it.p, Point2f(sample))  # type: ignore[attr-defined]

    def pdf_direction(self, it: Observer, ps: DirectionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_direction` at `ps`, per unit solid angle at `it`."""
        self._require_still()
        return dr.select(active, self.direction_density(it.p, ps), 0)  # type: ignore[attr-defined]

    def pdf_position(self, ps: PositionSample3f, active: Bool | bool = True) -> Float:
        """The density of `sample_position`, per unit area."""
        return dr.select(active, dr.rcp(self.surface_area()), 0)  # type: ignore[attr-defined]

    def _require_still(self) -> None:
        """Raise `RenderError` if the shape moves: it then answers in its own space."""
        if self.moves:  # type: ignore[attr-defined]
            raise RenderError(f"{self.id()}: points of what moves aren't sampled; ask the shapes of scene.at_time(t)")

    def used_in(self, scene: Any) -> None:
        """Note that a scene contains the shape."""
        self.users = [*(user for user in self.users if user() is not None), weakref.ref(scene)]

    # ---- a scene of its own -----------------------------------------------------------------

    def alone(self) -> Any:
        """A scene of this shape alone, or rather of a copy of it without emitter and sensor."""
        if "_alone" not in self.__dict__:
            only = copy.copy(self)
            only._emitter = only._sensor = None
            only._bsdf, only.original = self.bsdf(), self
            self._alone = lookup("scene", "scene")(Properties("scene", self.id(), {"shape": only}))
        return self._alone

    def prepare_to_record(self) -> None:
        self.make_parameters()
        if self.original is None:
            self.alone()

    def make_parameters(self) -> None:
        """Make the parameters that otherwise are made when they are asked for: frozen functions can't."""

    def forget_alone(self) -> None:
        """Drop the scene of the shape alone, after an edit."""
        self.__dict__.pop("_alone", None)

    def refresh(self, changed: Sequence[Plugin]) -> None:
        """Follow an edit of the shape where it is the root of a description."""
        self.forget_alone()
        self.stand_alone()
