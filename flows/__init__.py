"""Prefect flows: order, retries and wiring. Every line of work is a call into `conetl.pipeline`."""
