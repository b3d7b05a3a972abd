"""Scenes: plugins assembled into the data that kernels read, and the queries of integrators."""
