"""Renders and gradients on many machines, as tasks of `dask.distributed`, bit-identical to those on one machine.

client = distributed.Client("tcp://scheduler:8786")
for found in djpt.apps.cluster.render_passes(client, description, spp=4096): ...
"""

from djpt.apps.cluster.rendering import gradient, render_passes

__all__ = ["gradient", "render_passes"]
