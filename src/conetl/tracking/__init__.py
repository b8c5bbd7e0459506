"""Detections to tracks: stereo matching, positions, association, trajectory refinement and self-calibration of one drive.

It imports `perception` and everything below it, and knows nothing of a map. The story begins in `matching/matches.py` and ends
in `tracks.py`.
"""
