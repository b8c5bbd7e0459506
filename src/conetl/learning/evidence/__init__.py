"""What the scores of a network mean: images of labelled cones again and again, calibration, P(detect)."""
