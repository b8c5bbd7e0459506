-- Purpose: which of these locks some session of this database holds now. Parameters: names (text[]). Columns: name.
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
