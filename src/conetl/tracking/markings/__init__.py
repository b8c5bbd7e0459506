"""Points of lane markings of a drive to tracks: located, chained, told solid from dashed, fitted.

It imports `perception`, `geometry` and `model`. Start with `tracks.py`.
"""
