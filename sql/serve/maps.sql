-- Purpose: all maps with what a person chooses one by.
-- Columns: map_name, srid, changeset_count, feature_count (standing now), last_committed_at (of changesets and
-- decisions, as map/find_map; null while empty).
select
    m.map_name, m.srid,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    (select count(*) from conetl.current_feature f where f.map_id = m.map_id) as feature_count,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at
from conetl.map m
order by m.map_name;
