-- Purpose: the new versions, open in both periods; each begins at least a microsecond after the one that it follows.
-- Parameters: map_id, srid, changeset_id, committed_at (timestamptz).
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, category, geom, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz,
    centre_geom, cone_height_m, cone_height_sigma_m, existence_probability, observation_count,
    first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period, suppressed, calibrations, shared_jacobian_m
)
select
    coalesce(o.cell, (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0)),
    s.feature_id, coalesce(o.version, 0) + 1, %(map_id)s, %(srid)s, %(changeset_id)s, s.present, s.category, s.geom,
    s.cov_xx, s.cov_xy, s.cov_xz, s.cov_yy, s.cov_yz, s.cov_zz,
    s.centre_geom, s.cone_height_m, s.cone_height_sigma_m, s.existence_probability, s.observation_count,
    s.first_seen_ns, s.last_seen_ns, greatest(s.changed_at_ns, o.valid_from_ns + 1000),
    tstzrange(greatest(s.changed_at, o.valid_from + interval '1 microsecond'), null), tstzrange(%(committed_at)s, null), s.suppressed, s.calibrations, s.shared_jacobian_m
from delta_stage s
left join open_version o using (feature_id)
where s.is_change
order by 1, s.feature_id;
