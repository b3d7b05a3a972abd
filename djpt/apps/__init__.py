"""What people start: the command line, the viewer, clusters, animations, optimisation, notebooks."""
