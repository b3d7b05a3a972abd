"""The display of results in notebooks and terminals: images as the result of a cell, and progress bars."""
