"""Prefect flows: order, retries and wiring. Every line of work is a call into `conetl.pipeline`.

The story begins in `ingest_drive.py`; `prefect.yaml` names the deployments.
"""
