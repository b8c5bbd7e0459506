-- Purpose: what a manifest says about a map. Parameters: map_name.
-- Columns: licence (null where none was set), last_committed_at (of changesets and decisions), changeset_count, schema_version (the last
-- migration).
select
    m.licence,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    (select max(s.name) from conetl.schema_migration s) as schema_version
from conetl.map m
where m.map_name = %(map_name)s;
