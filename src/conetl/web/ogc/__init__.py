"""OGC API Features and vector tiles at `/ogc`: tipg over the functions of schema conetl_ogc, and nothing else of the database.

It imports the rest of `web` and what that may import. Start with `app.py`.
"""
