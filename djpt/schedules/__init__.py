"""How lanes are filled with the samples of an image."""
