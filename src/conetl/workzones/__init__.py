"""From the cones of the map to work zones with rows, tapers and closed lanes, and the check of their layout. Pure functions.

It imports `geometry` and `model`. Start with `work_zones.py`; the rules of the check are in `layout_check.py`, the numbers of
standards in `rules/`.
"""
