"""PostGIS: connections, migrations, COPY, locks, and the stores that read and write each group of tables.

Every SQL statement comes from the top-level `sql/`, except `analyze` and `drop table` beside bulk loads, the lock of migrations,
and COPY, whose columns are those of the data. Only `connection.py` imports psycopg2. It imports `readers` and everything below
it. Start with `connection.py`; the map's own tables are in `map/`, the private cluster in `cluster/`.
"""
