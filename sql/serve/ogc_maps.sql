-- Purpose: maps that hold something, for the collections of OGC API Features. Parameters: $1 name of one map, null for all.
-- Columns: map_name, srid, changeset_no (the newest), last_committed_at (of changesets and decisions, as map/find_map: both change what is
-- believed).
select
    m.map_name, m.srid, c.changeset_no,
    greatest(c.committed_at, (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)) as last_committed_at
from conetl.map m
join lateral (
    select x.changeset_no, x.committed_at
    from conetl.changeset x
    where x.map_id = m.map_id
    order by x.committed_at desc
    limit 1
) c on true
where $1::text is null or m.map_name = $1
order by m.map_name;
