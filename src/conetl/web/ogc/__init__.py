"""OGC API Features and vector tiles at `/ogc`: tipg over the functions of schema conetl_ogc, and nothing else of the database."""
