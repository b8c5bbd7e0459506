"""Files on disk and objects in storage: names, atomic writes, YAML read into models, Parquet files of intermediate results.

It imports `model` only. Start with `storage.py`, through which every other package opens what a drive holds.
"""
