"""How samples are computed: what must not change an image, memory, refusals."""
