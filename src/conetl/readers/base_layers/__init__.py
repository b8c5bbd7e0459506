"""Readers of base layers, the background of a map: point clouds (LAS, LAZ, COPC) and lane boundaries."""
