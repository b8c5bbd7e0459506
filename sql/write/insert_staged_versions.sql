-- Purpose: write the staged versions, believed from now on. Parameters: map_id, srid, committed_at (timestamptz).
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, category, geom, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz,
    centre_geom, cone_height_m, cone_height_sigma_m, existence_probability, observation_count,
    first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period, suppressed, calibrations, shared_jacobian_m
)
select
    f.cell, s.feature_id, s.version, %(map_id)s, %(srid)s, s.changeset_id, s.present, s.category, s.geom,
    s.cov_xx, s.cov_xy, s.cov_xz, s.cov_yy, s.cov_yz, s.cov_zz,
    s.centre_geom, s.cone_height_m, s.cone_height_sigma_m, s.existence_probability, s.observation_count,
    s.first_seen_ns, s.last_seen_ns, s.valid_from_ns,
    tstzrange(s.valid_from, case when not s.is_open then s.valid_to end), tstzrange(%(committed_at)s, null), s.suppressed, s.calibrations, s.shared_jacobian_m
from version_stage s
left join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0  -- a missing one is an error, not a row less
order by f.cell, s.feature_id, s.version;
