-- Purpose: write each replaced version down again as it is believed from now on: valid only until its successor begins, which is
-- at least a microsecond later, so that no state is ever lost. offset 0: one look into the primary key each, as in close_versions.
-- Parameters: committed_at (timestamptz).
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, category, geom, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz,
    centre_geom, cone_height_m, cone_height_sigma_m, existence_probability, observation_count,
    first_seen_ns, last_seen_ns, valid_from_ns, valid_period, system_period, suppressed, calibrations, shared_jacobian_m
)
select
    v.cell, v.feature_id, v.version, v.map_id, v.srid, v.changeset_id, v.present, v.category, v.geom,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    v.centre_geom, v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count,
    v.first_seen_ns, v.last_seen_ns, v.valid_from_ns,
    tstzrange(o.valid_from, greatest(s.changed_at, o.valid_from + interval '1 microsecond')),
    tstzrange(%(committed_at)s, null), v.suppressed, v.calibrations, v.shared_jacobian_m
from open_version o
join delta_stage s using (feature_id)
cross join lateral (select w.* from conetl.feature_version w where w.version_row_id = o.version_row_id offset 0) v
where s.is_change
order by v.cell, s.feature_id;
