"""A drive folder while it is recorded: which frame pairs are there by now, and their poses.

It imports `readers.drives`. The story begins in `drive.py`.
"""
