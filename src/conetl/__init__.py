"""conetl: stereo survey drives in, a versioned HD map of traffic cones out."""
