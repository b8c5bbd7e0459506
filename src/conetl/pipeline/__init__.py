"""The Python API: what conetl does with a drive and a map, as plain functions. No Prefect, no server.

It imports every package above `web` and `cli`. The story begins in `analysis.py`.
"""
