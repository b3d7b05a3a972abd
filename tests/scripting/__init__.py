"""Names for the sake of scripts written for Mitsuba."""
