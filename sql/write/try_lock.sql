-- Purpose: take a lock of this session if nobody holds it. Parameters: name. Columns: taken.
select pg_try_advisory_lock(hashtextextended(%(name)s, 0)) as taken;
