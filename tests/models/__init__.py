"""Descriptions, scene files, built-in scenes, parameters."""
