"""The map in a browser: a FastAPI server that only reads, and the front end built from `web/`."""
