"""Films: one file each, one registration line each."""

from djpt.description.registry import register_film
from djpt.films.hdrfilm import HDRFilm

__all__ = ["HDRFilm"]

register_film("hdrfilm", HDRFilm)
