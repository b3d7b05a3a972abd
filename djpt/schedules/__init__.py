"""Schedules: ways to fill lanes with the samples of an image."""
