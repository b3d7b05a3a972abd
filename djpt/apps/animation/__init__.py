"""Animations: parameters that move from frame to frame, frames as files that a later run goes on from, and movies."""
