"""The command line, the installed package, the choice of a backend."""
