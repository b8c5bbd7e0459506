"""Points of lane markings of a drive to tracks: located, chained, classified as solid or dashed, fitted.

It imports `perception`, `geometry` and `model`. Start with `tracks.py`.
"""
