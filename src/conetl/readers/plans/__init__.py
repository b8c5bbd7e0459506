"""Readers of planned work zones: publications and permits as records of `model/planned_zones.py`. They know no database."""
