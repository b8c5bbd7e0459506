"""Calibration boards in images: chessboard, ChArUco board and AprilGrid to numbered corners.

It imports the rest of `perception` and what that may import. Start with `boards.py`.
"""
