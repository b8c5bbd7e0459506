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

-- name: blockers
-- Sessions that hold what another one waits for. Parameters: pid. Columns: pid, login, program, address, state, since, statement.
select a.pid, a.usename as login, a.application_name as program, a.client_addr::text as address, a.state,
       a.xact_start as since, left(a.query, 200) as statement
from unnest(pg_blocking_pids(%(pid)s)) as blocking (pid)
join pg_stat_activity a on a.pid = blocking.pid
order by a.xact_start;

-- name: wait_without_limit
-- Locks that show which processes are alive are waited for as long as their holders work.
set lock_timeout = 0;
