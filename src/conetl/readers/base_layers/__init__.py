"""Readers of base layers, the background of a map: point clouds (LAS, LAZ, COPC) and lane boundaries.

Start with `line_files.py` (lines) and `las_file.py` (points).
"""
