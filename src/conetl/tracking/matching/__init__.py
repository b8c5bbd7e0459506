"""Detections of a frame pair to stereo matches with image points, by area-based least-squares matching.

It imports `geometry` and `model`. Start with `matches.py`.
"""
