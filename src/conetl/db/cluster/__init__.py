"""The private PostGIS cluster of a home folder: found, started, shared and stopped.

It imports `model` and the rest of `db`. The story begins in `cluster.py`.
"""
