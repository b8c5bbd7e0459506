-- Purpose: what happened to one feature: what is believed now in the order of the road, and what was believed once.
-- Parameters: feature_id.
-- Columns: as FeatureLogEntry; place and values are those after the change, of a removed feature the last ones.
select
    c.changeset_no, c.changeset_id, d.drive_id, m.map_name, x.kind, x.changed_at, lower(x.system_period) as committed_at,
    upper(x.system_period) as believed_until, x.old_version, x.new_version,
    x.track_index, x.shift_m, v.category, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cone_height_m, coalesce(x.existence_after, v.existence_probability) as existence_probability, v.observation_count, v.suppressed,
    x.other_feature_id, x.log_likelihood_ratio, x.frames_seen, x.frames_empty
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id
join lateral (
    select * from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version and v.system_period && x.system_period
    order by v.system_period desc, v.version_row_id
    limit 1
) v on true
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s
order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C", x.system_period;
