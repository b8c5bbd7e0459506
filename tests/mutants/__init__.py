"""Recordings that are well-formed and wrong, and what must become of each."""
