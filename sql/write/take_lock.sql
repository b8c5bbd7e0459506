-- Purpose: wait for a lock of this session; the server frees it when the session ends, however it ends. Parameters: name.
select pg_advisory_lock(hashtextextended(%(name)s, 0));
