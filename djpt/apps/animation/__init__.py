"""Animations: parameters that change from frame to frame, frames as files that a later run continues, and movies."""
