"""The private PostGIS cluster of a home folder: found, started, shared and stopped.

It imports `model` only. Start with `cluster.py`.
"""
