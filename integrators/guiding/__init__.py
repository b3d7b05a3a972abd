"""What paths learn, and other paths make use of.

* `guide`: the places that are told apart, as leaves of a tree over the scene; a distribution of directions for each
  leaf, and how to draw from it.
* `training`: paths that are only followed to learn from.
* `light_cache`: the light that media scatter, cell by cell.
"""
