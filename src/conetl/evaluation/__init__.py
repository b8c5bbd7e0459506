"""Drives against truth and LiDAR: errors, statistics and the consistency of the stated covariances.

It imports `pipeline` and everything below it. The story begins in `truth.py`.
"""
