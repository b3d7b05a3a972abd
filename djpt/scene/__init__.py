"""Scenes: plugins put together to what kernels read, and the queries that integrators make."""
