"""Photogrammetry in numpy: poses, cameras, lenses, intersection, coordinate systems, and adjustments in `calibration/` and
`motion/`.

It imports `model` only; arrays in, arrays out. Start with `camera.py` and `pose.py`, then `intersection.py`.
"""
