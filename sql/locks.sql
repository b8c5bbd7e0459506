-- Session locks, which the server frees when the session ends, however it ends; and locks of parts of a map.

-- name: take_lock
-- Wait for a lock of this session. Parameters: name. Columns: taken.
select true as taken from pg_advisory_lock(hashtextextended(%(name)s, 0));

-- name: try_lock
-- Take a lock of this session if no other session holds it. Parameters: name. Columns: taken.
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
-- Wait without limit for locks that are held as long as their holders work.
set lock_timeout = 0;

-- name: take_parts
-- Lock parts of maps one after the other, until the transaction or the savepoint before is ended. Parameters: names
-- (text[], always in the same order).
select pg_advisory_xact_lock(hashtextextended('conetl.map/' || part.name, 0)) from unnest(%(names)s::text[]) as part (name);

-- name: regions
-- The squares of side_m, numbered from the origin of the map's CRS, within margin_m of the areas of some drives, and of the
-- area of a path that is not stored yet (as drives.insert_drive makes it).
-- Parameters: drive_uuids (uuid[]); path_wkt (line, null: none), influence_m; side_m, margin_m. Columns: region.
with around (area) as (
    select d.area from conetl.drive d where d.drive_uuid = any(%(drive_uuids)s::uuid[])
    union all
    select ST_Buffer(ST_GeomFromText(%(path_wkt)s::text), 1.05 * %(influence_m)s + 5) where %(path_wkt)s::text is not null
)
select distinct format('%%s,%%s', x, y) as region
from around
cross join lateral conetl.pieces(area) piece
cross join lateral generate_series(
    floor((ST_XMin(piece) - %(margin_m)s) / %(side_m)s)::bigint, floor((ST_XMax(piece) + %(margin_m)s) / %(side_m)s)::bigint
) x
cross join lateral generate_series(
    floor((ST_YMin(piece) - %(margin_m)s) / %(side_m)s)::bigint, floor((ST_YMax(piece) + %(margin_m)s) / %(side_m)s)::bigint
) y;
