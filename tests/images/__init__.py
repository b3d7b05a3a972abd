"""Films, image files, tone mapping."""
