-- Purpose: one map. Parameters: map_name. Columns: map_id, map_name, srid, last_committed_at (null while empty).
select m.map_id, m.map_name, m.srid, (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id) as last_committed_at
from conetl.map m
where m.map_name = %(map_name)s;
