"""Prefect flows: retries, states and wiring. The order of a drive's steps is that of `pipeline/ingest.py` and `analysis.py`.

Start with `ingest_drive.py`. A new flow is listed in `prefect.yaml` (deployment, schedule) and in `FLOWS` of `runs.py`
(recovery after a crash).
"""
