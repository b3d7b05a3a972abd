"""Documentation, examples and the public names do what is said of them."""
