"""Prefect flows: order, retries and wiring. Every line of work is a call into `conetl.pipeline`.

Start with `ingest_drive.py`. A new flow is listed in `prefect.yaml` (deployment, schedule) and in `FLOWS` of `runs.py`
(recovery after a crash).
"""
