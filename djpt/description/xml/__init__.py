"""Mitsuba 3's XML scene files: read into dicts, written from dicts."""
