"""Prefect flows: order, retries and wiring. What is done stands in `conetl.steps` and `conetl.io`."""
