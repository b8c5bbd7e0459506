-- Purpose: what one changeset did to each feature it judged, as believed when it was committed. Parameters: changeset_id.
-- Columns: feature_id, kind, changed_at, shift_m, track_index (null: not seen), frames_seen, frames_empty; old_easting_m, old_northing_m
-- (null for added); easting_m, northing_m, height_m, sigma_m (horizontal), cone_height_m, existence_probability, observation_count.
select
    x.feature_id, x.kind, x.changed_at, x.shift_m, x.track_index, x.frames_seen, x.frames_empty,
    ST_X(o.geom) as old_easting_m, ST_Y(o.geom) as old_northing_m,
    ST_X(n.geom) as easting_m, ST_Y(n.geom) as northing_m, ST_Z(n.geom) as height_m,
    sqrt((n.cov_xx + n.cov_yy) / 2) as sigma_m, n.cone_height_m,
    coalesce(x.existence_after, n.existence_probability) as existence_probability, n.observation_count
from conetl.delta x
join conetl.changeset c using (changeset_id)
join lateral (
    select v.* from conetl.feature_version v
    where v.feature_id = x.feature_id and v.version = x.new_version
    order by v.system_period @> c.committed_at desc, v.version_row_id desc
    limit 1
) n on true
left join lateral (
    select v.geom from conetl.feature_version v
    where v.feature_id = x.feature_id and v.version = x.old_version
    order by v.system_period @> c.committed_at desc, v.version_row_id desc
    limit 1
) o on true
where x.changeset_id = %(changeset_id)s and x.system_period @> c.committed_at
order by x.feature_id;
