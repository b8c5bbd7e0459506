"""Background processes of `conetl up`, and access to a Prefect server.

It imports `model` and `files` only. Start with `processes.py`.
"""
