"""Silhouettes: where what is seen changes abruptly, and how shapes move with their parameters.

The derivative of an image by the place of a shape has two parts. One is the derivative of the integrand, as for
materials. The other is an integral over silhouettes, where the integrand jumps: T.-M. Li et al., "Differentiable Monte
Carlo Ray Tracing through Edge Sampling", ACM Trans. Graph. 37(6), 2018. Z. Zhang, N. Roussel and W. Jakob, "Projective
Sampling for Differentiable Rendering of Geometry", ACM Trans. Graph. 42(6), 2023, find silhouettes by projecting hits
of ordinary paths; that is what the questions of this package are for.
"""
