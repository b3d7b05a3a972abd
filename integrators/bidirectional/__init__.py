"""Parts of bidirectional path tracing: subpaths, their weights, strategies by themselves."""
