"""The light schedule: a lane follows one light path after the other and adds to any pixel.

Floating-point sums depend on the order of additions, and threads add in any order. Sums of whole numbers don't: so
contributions are scaled and rounded to 64-bit numbers, and an image is the same, bit for, bit for any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np

from djpt.integrators.ptracer import LightPath, ParticleTracer
from djpt.lanewide import wide
from djpt.lookup import as_float
from djpt.records import SurfaceInteraction3f
from djpt.schedules.job import Job
from djpt.types import Array4u64, Bool, Color3f, Float, Float64, Point2f, UInt32, UInt64

__all__ = ["splat_image"]
