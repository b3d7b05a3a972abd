"""The types of the chosen backend, and all that compiles code or knows the insides of Dr.Jit."""
