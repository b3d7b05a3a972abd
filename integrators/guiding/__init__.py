"""Path guiding: what paths learn about the directions that light comes from.

* `guide`: the places that are told apart, as leaves of a tree over the scene; a distribution of directions for each
  leaf, and how to draw from it.
* `training`: paths that are only followed to learn from.
"""
