"""Processes on this machine that outlive a command: the private PostGIS cluster, Prefect, workers, the view."""
