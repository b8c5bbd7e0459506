"""Files from other programs: drives, rigs, drives being recorded, base layers, lane boundaries, maps. One module per format.

It imports `perception` (image headers) and everything below it. Start with `drives/__init__.py`, where `read_drive`
finds the format.
"""
