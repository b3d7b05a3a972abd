"""BSDFs: what they claim of themselves, Mitsuba's numbers, closed forms."""
