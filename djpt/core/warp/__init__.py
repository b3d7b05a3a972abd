"""Warps: maps from uniform samples on [0, 1) or [0, 1)^2 to other domains, their inverses, and their densities.

`square_to_X` is area-preserving up to the density `square_to_X_pdf`, which is 0 outside of the domain; `X_to_square`
undoes it. Samples may be Dr.Jit arrays, numbers, lists, tuples or NumPy arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from djpt.core.lazy import lazily

if TYPE_CHECKING:
    from djpt.core.warp.disk import square_to_uniform_disk as square_to_uniform_disk
    from djpt.core.warp.disk import square_to_uniform_disk_concentric as square_to_uniform_disk_concentric
    from djpt.core.warp.disk import square_to_uniform_disk_concentric_pdf as square_to_uniform_disk_concentric_pdf
    from djpt.core.warp.disk import square_to_uniform_disk_pdf as square_to_uniform_disk_pdf
    from djpt.core.warp.disk import square_to_uniform_square_concentric as square_to_uniform_square_concentric
    from djpt.core.warp.disk import uniform_disk_to_square as uniform_disk_to_square
    from djpt.core.warp.disk import uniform_disk_to_square_concentric as uniform_disk_to_square_concentric
    from djpt.core.warp.edges import interval_to_tangent_direction as interval_to_tangent_direction
    from djpt.core.warp.edges import square_to_uniform_spherical_lune as square_to_uniform_spherical_lune
    from djpt.core.warp.edges import square_to_uniform_spherical_lune_pdf as square_to_uniform_spherical_lune_pdf
    from djpt.core.warp.edges import tangent_direction_to_interval as tangent_direction_to_interval
    from djpt.core.warp.edges import uniform_spherical_lune_to_square as uniform_spherical_lune_to_square
    from djpt.core.warp.lobes import beckmann_to_square as beckmann_to_square
    from djpt.core.warp.lobes import square_to_beckmann as square_to_beckmann
    from djpt.core.warp.lobes import square_to_beckmann_pdf as square_to_beckmann_pdf
    from djpt.core.warp.lobes import square_to_rough_fiber as square_to_rough_fiber
    from djpt.core.warp.lobes import square_to_rough_fiber_pdf as square_to_rough_fiber_pdf
    from djpt.core.warp.lobes import square_to_von_mises_fisher as square_to_von_mises_fisher
    from djpt.core.warp.lobes import square_to_von_mises_fisher_pdf as square_to_von_mises_fisher_pdf
    from djpt.core.warp.lobes import von_mises_fisher_to_square as von_mises_fisher_to_square
    from djpt.core.warp.plane import bilinear_to_square as bilinear_to_square
    from djpt.core.warp.plane import interval_to_linear as interval_to_linear
    from djpt.core.warp.plane import interval_to_nonuniform_tent as interval_to_nonuniform_tent
    from djpt.core.warp.plane import interval_to_tent as interval_to_tent
    from djpt.core.warp.plane import linear_to_interval as linear_to_interval
    from djpt.core.warp.plane import square_to_bilinear as square_to_bilinear
    from djpt.core.warp.plane import square_to_bilinear_pdf as square_to_bilinear_pdf
    from djpt.core.warp.plane import square_to_std_normal as square_to_std_normal
    from djpt.core.warp.plane import square_to_std_normal_pdf as square_to_std_normal_pdf
    from djpt.core.warp.plane import square_to_tent as square_to_tent
    from djpt.core.warp.plane import square_to_tent_pdf as square_to_tent_pdf
    from djpt.core.warp.plane import square_to_uniform_triangle as square_to_uniform_triangle
    from djpt.core.warp.plane import square_to_uniform_triangle_pdf as square_to_uniform_triangle_pdf
    from djpt.core.warp.plane import tent_to_interval as tent_to_interval
    from djpt.core.warp.plane import tent_to_square as tent_to_square
    from djpt.core.warp.plane import uniform_triangle_to_square as uniform_triangle_to_square
    from djpt.core.warp.sphere import cosine_hemisphere_to_square as cosine_hemisphere_to_square
    from djpt.core.warp.sphere import square_to_cosine_hemisphere as square_to_cosine_hemisphere
    from djpt.core.warp.sphere import square_to_cosine_hemisphere_pdf as square_to_cosine_hemisphere_pdf
    from djpt.core.warp.sphere import square_to_uniform_cone as square_to_uniform_cone
    from djpt.core.warp.sphere import square_to_uniform_cone_pdf as square_to_uniform_cone_pdf
    from djpt.core.warp.sphere import square_to_uniform_hemisphere as square_to_uniform_hemisphere
    from djpt.core.warp.sphere import square_to_uniform_hemisphere_pdf as square_to_uniform_hemisphere_pdf
    from djpt.core.warp.sphere import square_to_uniform_sphere as square_to_uniform_sphere
    from djpt.core.warp.sphere import square_to_uniform_sphere_pdf as square_to_uniform_sphere_pdf
    from djpt.core.warp.sphere import uniform_cone_to_square as uniform_cone_to_square
    from djpt.core.warp.sphere import uniform_hemisphere_to_square as uniform_hemisphere_to_square
    from djpt.core.warp.sphere import uniform_sphere_to_square as uniform_sphere_to_square
else:
    __getattr__, __dir__, __all__ = lazily(__name__)
