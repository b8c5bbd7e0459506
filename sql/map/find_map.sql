-- Purpose: one map. Parameters: map_name. Columns: map_id, map_name, srid, last_committed_at (of changesets and decisions; null
-- while empty).
select
    m.map_id, m.map_name, m.srid,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at
from conetl.map m
where m.map_name = %(map_name)s;
