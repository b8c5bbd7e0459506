"""Tracks to changes of the map: visibility, association with features, fusion, and the fold over all drives. Pure functions.

It imports `tracking` and everything below it; no files, no database. The story begins in `fold.py`, which calls `changes.py`
for each drive.
"""
