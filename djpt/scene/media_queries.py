"""What a scene knows of its media, and what they leave of light."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import drjit as dr

from djpt.core.records import Ray3f, SurfaceInteraction3f
from djpt.dispatch.ensemble import Lookup
from djpt.errors import ArgumentError
from djpt.geometry.aggregate import Geometry
from djpt.jit.types import Color3f, Float, Point3f, UInt32, Vector3f
from djpt.scene.media_placement import Media, absorbing_sides, all_sides

if TYPE_CHECKING:
    from djpt.media.pointer import MediumPtr
    from djpt.sensors.base import Sensor

__all__ = ["MediaQueries"]


class MediaQueries:
    """The part of a scene that is about media."""

    geometry: Geometry
    lookup: Lookup
    _sensors: list[Sensor]
    camera_medium: UInt32 | None
    """The number of the medium that camera rays start in; None if no media are followed."""
    outer_medium: UInt32 | None = None
    """The number of the medium outside of all bodies, if a sensor says that there is one."""
    media: Media
    """The media that are followed along rays: those that absorb without scattering, or all (see `with_media`)."""
    every_medium: Media

    def find_media(self) -> None:
        """Number the media of shapes and sensors."""
        shapes = self.geometry.contents.shapes
        self.media = self.every_medium = Media(self.geometry, absorbing_sides(shapes))
        of_sensors = [sensor.get_medium() for sensor in self._sensors if sensor.get_medium() is not None]
        if of_sensors or any(shape.is_medium_transition() for shape in shapes):
            self.every_medium = Media(self.geometry, all_sides(shapes), of_sensors)

    def prepare_media(self) -> None:
        """Build the tables of media, after the scene was compiled or edited."""
        self.media.prepare()
        self.every_medium.prepare()

    def _view(self) -> Any:
        """A shallow copy of the scene."""
        raise NotImplementedError

    # ---- which medium ------------------------------------------------------------------

    def with_media(self) -> Any:
        """A view of this scene that follows all media along rays, not only those that absorb without scattering."""
        if self.media is self.every_medium:
            return self
        view = self._view()
        view.media = self.every_medium
        view.camera_medium = UInt32(view.media.vacuum)
        return view

    def begin_in_media_of(self, sensor: Sensor) -> None:
        """Note where the rays of a sensor start, and, if it stands outside of all bodies, that its medium is there."""
        vacuum, given = self.media.vacuum, self.media.number(sensor.get_medium())
        around = self.media.around(sensor.viewpoint(), self.lookup)
        self.camera_medium = dr.opaque(UInt32, around if given == vacuum else given)
        self.outer_medium = dr.opaque(UInt32, given) if given != vacuum and around == vacuum else None

    def target_medium(self, si: SurfaceInteraction3f, d: Any, cos_theta: Any = None) -> MediumPtr:
        """The medium that a shape names for the side of `si` that a direction points to; none if it names none.

        The direction `d` is in world space; or one number says its cosine with the normal, as `d` or `cos_theta`.

        Raises:
            ArgumentError: neither or both are given.
        """
        if (d is None) == (cos_theta is None):
            raise ArgumentError("target_medium(): give a direction 'd' or its cosine with the normal, 'cos_theta'")
        d = cos_theta if d is None else d
        direction = si.n * d if dr.depth_v(d) < 2 else Vector3f(d)
        from djpt.dispatch.family import Family
        from djpt.media.pointer import MediumPtr

        media = self.every_medium
        pointer: MediumPtr = MediumPtr.into(Family(media.ensemble, self.lookup), media.side(si, direction))
        return pointer

    def medium_beyond(self, si: SurfaceInteraction3f, d: Vector3f) -> UInt32 | None:
        """The medium of a ray that leaves `si` in the world direction `d`."""
        return self.media.beyond(si, d) if self.media else si.medium

    def medium_at(self, p: Point3f) -> UInt32 | None:
        """The medium that each point lies in, for rays that begin there; None in scenes without media."""
        return self.media.at(p, self.lookup, outside=self.outer_medium) if self.media else None

    # ---- what is left of light ----------------------------------------------------------

    def left_by_media(self, ray: Ray3f, light: Color3f) -> Color3f:
        """The part of `light` that media leave along the segment of a `shadow_ray`, whatever surfaces stand between."""
        if not self.media or ray.medium is None:
            return light
        return light * self.transmittance(ray, dr.select(ray.maxt < dr.inf, dr.norm(ray.d), dr.inf))

    def transmittance(self, ray: Ray3f, distance: Float) -> Color3f:
        """The share of light that media leave over a distance along a ray from its origin; 1 in vacuum."""
        if not self.media or ray.medium is None:
            return Color3f(1)
        return self.media.transmittance(ray, distance, self.lookup)
