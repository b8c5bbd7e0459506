"""Checks of a drive against the other drives and the map in the database."""
