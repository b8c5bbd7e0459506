"""The Python API: read_drive -> analyse -> commit -> publish as plain functions. No Prefect, no server.

It may import every package but `cli`, `web`, `evaluation` and `simulation`. The story begins in `ingest.py`, which calls
`analysis.py`, `commit.py` and `publish.py` in this order.
"""
