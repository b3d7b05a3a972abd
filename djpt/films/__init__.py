"""Films, one per file. The file registers its film; one line here imports it."""

from djpt.films.base import Film as Film
from djpt.films.base import FilmFlags as FilmFlags
from djpt.films.hdrfilm import HDRFilm as HDRFilm

__all__ = [name for name, value in globals().items() if isinstance(value, type)]
