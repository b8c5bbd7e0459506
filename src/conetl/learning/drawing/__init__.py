"""Cones, other road objects and distractors drawn by formula."""
