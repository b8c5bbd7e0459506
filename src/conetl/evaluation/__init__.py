"""Drives against truth and LiDAR: errors, statistics and the consistency of the stated covariances.

It imports `pipeline` and everything below it. Start with `truth.py`.
"""
