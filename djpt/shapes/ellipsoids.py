"""Clouds of ellipsoids: the supports of Gaussians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from djpt.core.transforms import ScalarTransform4f
from djpt.description.properties import Properties
from djpt.description.registry import register_shape
from djpt.shapes.curve_segments import CurveSegments, ellipsoid_pieces
from djpt.shapes.ellipsoid_cloud import Cloud
from djpt.shapes.mitsuba_api import ShapeType

__all__ = ["Ellipsoids"]


class Ellipsoids(Cloud):
    """Ellipsoids with attributes, seen from outside alone: the primitives of volumes made of Gaussians.

    Parameters: one of

    * `filename`: a PLY file, see `djpt.shapes.ellipsoid_cloud`; then also `scale_factor` (default 1) and `to_world`;
    * `data`: (N, 10) numbers: centre, scales, quaternion x y z w;
    * `centers` (N, 3), `scales` (N, 3) and `quaternions` (N, 4);

    and `extent` (default 3): the half-axes are the scales times this; `extent_adaptive_clamping` (default false):
    where the attribute `opacities` is o, times sqrt(2 log(o / 0.01)) / 3 as well. All other keys are attributes: (N, D)
    numbers, which `eval_attribute_1`, `_3` and `_x` look up by the number of the ellipsoid, `si.prim_index`.

    There are no uv, and ellipsoids can't shine. Attributes and `data` have derivatives where scripts look them up
    (`data` as the attributes `ellipsoid`, `center`, `scale` and `quaternion`), and in images of the integrator
    `volprim_rf_basic`; hits have none.
    """

    in_any_frame = True
    shape_kind = ShapeType.Ellipsoids
    in_pieces = True
    canonical = "piece"

    def __init__(self, props: Properties) -> None:
        super().__init__(props)
        self.read_cloud(props)
        # Instances set this for copies: files have been moved already.
        self.to_world = ScalarTransform4f()

    def _placed(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres (N, 3) and maps (N, 3, 3) in world space."""
        linear, shift = self.to_world.matrix[:3, :3], self.to_world.matrix[:3, 3]
        return self._table()[:, :3] @ linear.T + shift, linear @ self._half_axes()

    def interval(self, direction: NDArray[np.float64]) -> tuple[float, float]:
        centers, axes = self._placed()
        along, reach = centers @ direction, np.linalg.norm(direction @ axes, axis=1)
        return float((along - reach).min()), float((along + reach).max())

    def pieces(self) -> CurveSegments:
        """The ellipsoids as pieces, in world space."""
        return ellipsoid_pieces(*self._placed())


register_shape("ellipsoids", Ellipsoids)
