-- Purpose: one line about a map. Parameters: map_name.
-- Columns: map_name, srid, feature_count (standing now), removed_count (gone), version_count (believed now), changeset_count,
-- last_committed_at (of changesets and decisions, as map/find_map), last_captured_to_ns, west_m, south_m, east_m, north_m (null where empty).
select
    m.map_name, m.srid,
    count(v.*) filter (where v.present and upper_inf(v.valid_period)) as feature_count,
    count(v.*) filter (where not v.present and not v.suppressed and upper_inf(v.valid_period)) as removed_count,
    count(v.*) as version_count,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at,
    (select max(d.captured_to_ns) from conetl.drive d where d.map_id = m.map_id) as last_captured_to_ns,
    min(ST_X(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as west_m,
    min(ST_Y(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as south_m,
    max(ST_X(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as east_m,
    max(ST_Y(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as north_m
from conetl.map m
left join conetl.feature_version v on v.map_id = m.map_id and upper_inf(v.system_period)
where m.map_name = %(map_name)s
group by m.map_id;
