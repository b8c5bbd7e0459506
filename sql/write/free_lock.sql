-- Purpose: free a lock of this session. Parameters: name.
select pg_advisory_unlock(hashtextextended(%(name)s, 0));
