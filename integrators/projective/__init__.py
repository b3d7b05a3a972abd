"""Parts of projective sampling: derivatives of what moving shapes hide and show."""
