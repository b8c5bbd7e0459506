"""Files that others made: drives, rigs, drives being recorded, base layers, lane boundaries, maps. One module per format.

It imports `perception` (image headers) and everything below it. The story begins in `drives/__init__.py`, where `read_drive`
finds the format.
"""
