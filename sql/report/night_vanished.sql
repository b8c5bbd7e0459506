-- Purpose: cones that drives committed in a span took off the map, as believed now. Parameters: map_name, since, until, max_rows.
-- Columns: feature_id, kind (removed, merged), changeset_no, drive_id, changed_at, easting_m, northing_m, height_m, cone_height_m,
-- existence_after, frames_empty, first_seen_ns, total (of all rows).
select
    x.feature_id, x.kind, c.changeset_no, d.drive_id, x.changed_at, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m,
    ST_Z(v.geom) as height_m, v.cone_height_m, x.existence_after, x.frames_empty, v.first_seen_ns, count(*) over () as total
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
join conetl.feature_version v
    on v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version and upper_inf(v.system_period) and upper_inf(v.valid_period)
where m.map_name = %(map_name)s and c.committed_at >= %(since)s and c.committed_at < %(until)s
and x.kind in ('removed', 'merged') and upper_inf(x.system_period)
order by c.changeset_no, x.feature_id
limit %(max_rows)s;
