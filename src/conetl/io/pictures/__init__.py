"""Picture files: read safely, resampled for geometry, cut out and drawn on for people."""
