"""The map's own tables: features and their versions, drives with their records, imports and decisions.

It imports the rest of `db` and what that may import. Start with `map_store.py` (reading) and `commit.py` (writing).
"""
