"""Models in files and in memory, as scenes: glTF, OBJ, STL, OFF, 3MF and PLY, meshes of other libraries and arrays.

A reader turns a file into a `djpt.models.model.Model`, `djpt.models.stage` sets a stage for it.
"""
