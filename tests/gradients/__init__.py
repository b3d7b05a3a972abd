"""Derivatives of images, against finite differences and against Mitsuba."""
