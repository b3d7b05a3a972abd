"""Parts of projective sampling: derivatives of the visibility changes that moving shapes cause."""
