"""Calibration of a two-camera rig: from views of a board, or from a drive; the covariance of its parameters and what that does
to points.

It imports the rest of `geometry` and `model`. Start with `stereo_calibration.py`; `self_calibration.py` is its part on
the road.
"""
