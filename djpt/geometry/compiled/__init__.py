"""Trees over triangles that machine code builds, fits to moved triangles, and searches with rays one by one."""
