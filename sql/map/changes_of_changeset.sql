-- Purpose: what one changeset did to each feature it judged. Parameters: map_name; changeset_no.
-- Columns: feature_id, kind, changed_at, shift_m, track_index (null: not seen), frames_seen, frames_empty, old_easting_m,
-- old_northing_m, old_height_m (null for added); easting_m, northing_m, height_m (after it; of a removed feature the last
-- place), cov_xx, cov_xy, cov_yy (m^2), cone_height_m,
-- existence_probability (after this drive's look), observation_count, version. All as believed when it was committed: an earlier drive
-- that comes later may have given the drive another part since, which the history of a feature tells. Kind 'missed': the drive
-- looked for it in vain and left it standing.
select
    x.feature_id, x.kind, x.changed_at, x.shift_m, x.track_index, x.frames_seen, x.frames_empty,
    ST_X(o.geom) as old_easting_m, ST_Y(o.geom) as old_northing_m, ST_Z(o.geom) as old_height_m,
    ST_X(n.geom) as easting_m, ST_Y(n.geom) as northing_m, ST_Z(n.geom) as height_m,
    n.cov_xx, n.cov_xy, n.cov_yy, n.cone_height_m,
    coalesce(x.existence_after, n.existence_probability) as existence_probability, n.observation_count, n.version
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
join lateral (
    select v.* from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
    order by v.system_period @> c.committed_at desc, v.version_row_id desc
    limit 1
) n on true
left join lateral (
    select v.geom from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.old_version
    order by v.system_period @> c.committed_at desc, v.version_row_id desc
    limit 1
) o on true
where m.map_name = %(map_name)s and c.changeset_no = %(changeset_no)s and x.system_period @> c.committed_at
order by x.feature_id;
