"""Cameras of photographs, by structure from motion or calibration: COLMAP, NeRF, OpenCV and Bundler, as sensors.

A reader turns files into `djpt.photographs.photograph.Photographs`.
"""
