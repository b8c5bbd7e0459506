"""Readers of base layers, the background of a map: point clouds (LAS, LAZ, COPC) and lane boundaries.

The story begins in `line_files.py` (lines) and `las_file.py` (points).
"""
