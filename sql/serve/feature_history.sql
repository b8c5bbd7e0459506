-- Purpose: what happened to one feature of a map, in the order of the changesets. Parameters: map_name; feature_id.
-- Columns: changeset_no, drive_id, drive_uuid, kind, changed_at, committed_at, version, shift_m; then place, covariance (m^2) and
-- values after the change, of a removed feature the last ones; sighting_count: frame pairs of this drive that it rests on;
-- seen_count, missed_count: drives that saw the feature, and that looked in vain, up to now. A split is told as added, a merger as
-- removed, another height as confirmed; drives that looked in vain and left it standing are only counted.
select
    c.changeset_no, d.drive_id, d.drive_uuid,
    case x.kind when 'split' then 'added' when 'merged' then 'removed' when 'height_changed' then 'confirmed' else x.kind end as kind,
    x.changed_at, c.committed_at, x.new_version as version, x.shift_m, v.category,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    (
        select count(*) from conetl.track_member t
        where t.drive_uuid = d.drive_uuid and t.track_index = x.track_index
    ) as sighting_count,
    e.seen_count, e.missed_count
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id
join lateral (
    select * from conetl.feature_version v
    where v.feature_id = x.feature_id and v.version = x.new_version
    order by upper_inf(v.system_period) desc, v.version_row_id desc  -- what is believed now
    limit 1
) v on true
cross join conetl.feature_evidence(%(feature_id)s, 0) e
where x.feature_id = %(feature_id)s and m.map_name = %(map_name)s and upper_inf(x.system_period) and x.kind <> 'missed'
order by c.changeset_no;
