"""Searches of the BVH by steps that all lanes take together, without compiled functions."""
