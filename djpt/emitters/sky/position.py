"""The position of the sun at a time and a place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from djpt.description.properties import Allowed

__all__ = ["FARTHEST", "WITHIN_REACH", "TimeAndPlace", "sun_direction"]

FARTHEST = 1_000_000
"""The largest number of a date, a time or an angle: of larger ones trigonometry and calendars are noise."""

WITHIN_REACH = Allowed(-FARTHEST, FARTHEST)
"""The range of dates, times and angles."""

EPOCH = 2451545.0
"""The Julian date of noon, universal time, on 1 January 2000."""
DEGREE = math.pi / 180
PARALLAX = 6371.01 / 149597890.0
"""The radius of the earth over its distance from the sun."""


@dataclass
class TimeAndPlace:
    """A date, a time of day and a place on the earth: angles in degrees, times in hours, minutes and seconds."""

    latitude: float = 35.6894
    longitude: float = 139.6917
    timezone: float = 9.0
    year: int = 2010
    month: int = 7
    day: int = 10
    hour: float = 15.0
    minute: float = 0.0
    second: float = 0.0

    def universal_hours(self) -> float:
        """The universal time of day in hours."""
        return self.hour - self.timezone + (self.minute + self.second / 60) / 60

    def days(self) -> float:
        """The days since noon on 1 January 2000, universal time.

        H. F. Fliegel and T. C. van Flandern, "A Machine Algorithm for Processing Calendar Dates", CACM 11(10), 1968.
        Its divisions round towards zero.
        """
        january = int((self.month - 14) / 12)  # -1 in January and February, which count with the year before
        julian_day = (
            (1461 * (self.year + 4800 + january)) // 4
            + (367 * (self.month - 2 - 12 * january)) // 12
            - (3 * ((self.year + 4900 + january) // 100)) // 4
            + self.day
            - 32075
        )
        return julian_day - 0.5 + self.universal_hours() / 24 - EPOCH

    def sun_direction(self) -> NDArray[np.float64]:
        """The direction of the sun, (3,): see `sun_direction`."""
        return np.array(sun_direction(self.days(), self.universal_hours(), self.latitude, self.longitude))


def sun_direction(days: Any, universal_hours: Any, latitude: Any, longitude: Any) -> tuple[Any, Any, Any]:
    """The direction of the sun: z points up, x to the south and y to the west, a left-handed system.

    M. Blanco-Muriel, D. C. Alarcon-Padilla, T. Lopez-Moratalla and M. Lara-Coira, "Computing the Solar Vector",
    Solar Energy 70(5), 2001: exact to half a minute of arc from 1999 to 2015.

    Args:
        days: the days since noon on 1 January 2000, universal time; floats, or Dr.Jit arrays, like all arguments.
        universal_hours: the universal time of day in hours.
        latitude: in degrees.
        longitude: in degrees.
    """
    ecliptic_longitude, obliquity = ecliptic(days)
    along = dr.sin(ecliptic_longitude)
    right_ascension = dr.atan2(dr.cos(obliquity) * along, dr.cos(ecliptic_longitude))
    declination = dr.asin(dr.sin(obliquity) * along)
    sidereal_hours = 6.6974243242 + 0.0657098283 * days + universal_hours
    hour_angle = (15 * sidereal_hours + longitude) * DEGREE - right_ascension
    sin_latitude, cos_latitude = dr.sin(latitude * DEGREE), dr.cos(latitude * DEGREE)
    cos_hour_angle = dr.cos(hour_angle)

    zenith = dr.safe_acos(cos_latitude * cos_hour_angle * dr.cos(declination) + dr.sin(declination) * sin_latitude)
    zenith = zenith + PARALLAX * dr.sin(zenith)
    # From the north to the east.
    azimuth = dr.atan2(-dr.sin(hour_angle), dr.tan(declination) * cos_latitude - sin_latitude * cos_hour_angle)
    across = -dr.sin(zenith)
    return across * dr.cos(azimuth), across * dr.sin(azimuth), dr.cos(zenith)


def ecliptic(days: Any) -> tuple[Any, Any]:
    """The sun's longitude along the ecliptic, and the ecliptic's obliquity, in radians, `days` after the epoch."""
    omega = 2.1429 - 0.0010394594 * days
    mean_longitude = 4.8950630 + 0.017202791698 * days
    anomaly = 6.2400600 + 0.0172019699 * days
    longitude = (
        mean_longitude
        + 0.03341607 * dr.sin(anomaly)
        + 0.00034894 * dr.sin(2 * anomaly)
        - 0.0001134
        - 0.0000203 * dr.sin(omega)
    )
    return longitude, 0.4090928 - 6.2140e-9 * days + 0.0000396 * dr.cos(omega)
