"""The Python API: read_drive -> analyse -> commit -> publish as plain functions. No Prefect, no server.

It may import every package but `cli`, `web`, `evaluation` and `simulation`. Start with `ingest.py`, which calls `analysis.py`,
`commit.py` and `publish.py` in this order.
"""
