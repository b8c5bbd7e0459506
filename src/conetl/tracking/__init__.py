"""Detections to tracks: stereo matching, positions, association, trajectory refinement and self-calibration of one drive.

It imports `perception` and everything below it, no maps. Start with `matching/matches.py` and `tracks.py`; `health.py`
checks the drive against its own log.
"""
