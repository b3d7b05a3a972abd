"""Measurements of djpt against Mitsuba on this machine: ``python -m djpt.benchmarks SCENE...``."""
