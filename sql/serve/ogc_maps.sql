-- Purpose: maps that hold something, for the collections of OGC API Features. Parameters: $1 name of one map, null for all.
-- Columns: map_name, srid, changeset_no, committed_at (of the newest changeset).
select m.map_name, m.srid, c.changeset_no, c.committed_at
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
