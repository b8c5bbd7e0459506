"""Recordings that are well-formed and wrong, and what must become of each.

`table.py` lists them; `recordings.py` changes poses, clocks and calibration, `images.py` images and files of the log.
"""
