"""Photogrammetry in numpy: poses, cameras, lenses, intersection, coordinate systems, and adjustments in `calibration/` and
`motion/`.

It imports `model` only; arrays in, arrays out. The story begins in `camera.py` and `pose.py`, and leads to `intersection.py`.
"""
