-- Session locks: the server frees them when the session ends, however it ends.

-- name: take_lock
-- Wait for a lock of this session. Parameters: name.
select pg_advisory_lock(hashtextextended(%(name)s, 0));

-- name: try_lock
-- Take a lock of this session if nobody holds it. Parameters: name. Columns: taken.
select pg_try_advisory_lock(hashtextextended(%(name)s, 0)) as taken;

-- name: free_lock
-- Free a lock of this session. Parameters: name.
select pg_advisory_unlock(hashtextextended(%(name)s, 0));

-- name: held_locks
-- Which of these locks a session of this database holds now. Parameters: names (text[]). Columns: name.
select wanted.name
from unnest(%(names)s::text[]) as wanted (name)
where exists (
    select
    from pg_locks l
    where l.locktype = 'advisory' and l.granted and l.objsubid = 1
    and l.database = (select oid from pg_database where datname = current_database())
    -- The two halves of the 64-bit key, as pg_locks shows them.
    and l.classid::bigint = ((hashtextextended(wanted.name, 0) >> 32) & 4294967295)
    and l.objid::bigint = (hashtextextended(wanted.name, 0) & 4294967295)
);
