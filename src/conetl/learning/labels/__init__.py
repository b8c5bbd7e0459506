"""Labelled images: out of a map with its decisions, from CVAT, Label Studio and YOLO, and the folder in between."""
