"""The map in a browser: a FastAPI server and the front end built from `web/`."""
