"""Tracks to changes of the map: visibility, association with features, fusion, and the history over all drives. Pure functions.

It imports `tracking` and everything below it; no files, no database. Start with `history.py`, which calls `changes.py` for each
drive, or `markings.py` for its lane markings; `existence_update.py` combines the evidence of all drives.
"""
