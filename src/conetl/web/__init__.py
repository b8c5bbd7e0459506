"""The map in a browser: a FastAPI server and the front end built from `web/`.

It imports `pipeline` and everything below it. Start with `app.py`.
"""
