"""Calibration boards and files: pictures -> corners, and the formats of other programs."""
