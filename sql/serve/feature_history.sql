-- Purpose: what every drive said of one feature of a map, in the order of the drives on the road. Parameters: map_name; feature_id.
-- Columns: changeset_no, drive_id, drive_uuid, captured_from_ns, kind ('missed': looked for in vain, left standing), changed_at,
-- committed_at, version, shift_m, other_feature_id (of a split what was both, of a merger what is left), frames_empty (frame pairs
-- that looked at its spot in vain); then place, covariance (m^2) and values after the drive, of a removed feature the last ones,
-- existence_probability with this drive's evidence; sighting_count: frame pairs of this drive that it rests on; seen_count,
-- missed_count: drives (not imported maps) that saw the feature, and that looked in vain, this one included, later ones left out.
select
    c.changeset_no, d.drive_id, d.drive_uuid, d.captured_from_ns, x.kind, x.changed_at, c.committed_at,
    x.new_version as version, x.shift_m, x.other_feature_id, x.frames_empty, v.category,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    v.cone_height_m, v.cone_height_sigma_m,
    coalesce(x.existence_after, v.existence_probability) as existence_probability,
    v.observation_count, v.first_seen_ns, v.last_seen_ns,
    (
        select count(*) from conetl.track_member t
        where t.drive_uuid = d.drive_uuid and t.track_index = x.track_index
    ) as sighting_count,
    count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive') over on_the_road as seen_count,
    count(*) filter (where x.kind in ('missed', 'removed')) over on_the_road as missed_count
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id
join lateral (
    select * from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
    order by upper_inf(v.system_period) desc, v.version_row_id desc  -- what is believed now
    limit 1
) v on true
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and m.map_name = %(map_name)s and upper_inf(x.system_period)
window on_the_road as (
    order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C"
    rows unbounded preceding
)
order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C";
