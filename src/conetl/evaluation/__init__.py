"""Drives against truth and LiDAR: errors, statistics and whether stated covariances hold.

It imports `pipeline` and everything below it. The story begins in `truth.py`.
"""
