"""The map as files for other programs."""
