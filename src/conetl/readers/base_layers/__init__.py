"""Readers of base layers: what a map lies on. Point clouds (LAS, LAZ, COPC, a drive's own LiDAR) and lane boundaries."""
