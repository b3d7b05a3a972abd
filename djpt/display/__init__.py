"""What notebooks and terminals show: images as the result of a cell, and bars while something is rendered."""
