"""Estimators of light transport: closed forms, agreement with each other and with Mitsuba."""
