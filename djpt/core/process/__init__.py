"""The process: the memory that it can take, and the signals that end it."""
