"""Detections to tracks: stereo matching, positions, association, trajectory refinement and self-calibration of one drive.

It imports `perception` and everything below it, no maps. Start with `matching/matches.py` and `tracks.py`; `checks/` has
the health checks of a drive.
"""
