"""Parts of path tracers: vertices, transmittance, the loop over a path, bases of integrators."""
