"""Samplers, and every plugin that samples, by what it claims of itself."""
