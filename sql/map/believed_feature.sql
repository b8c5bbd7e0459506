-- Purpose: what is believed now of one feature: its open version. Parameters: map_name, feature_id. Columns: as FeatureVersion.
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    array_send(v.calibrations) || array_send(v.shared_jacobian_m),
    v.changeset_id, v.present or v.suppressed, v.suppressed, v.valid_from_ns, null::bigint
from conetl.feature_version v
join conetl.map m using (map_id)
where v.cell = conetl.cell_of(%(feature_id)s) and v.feature_id = %(feature_id)s and m.map_name = %(map_name)s and upper_inf(v.system_period) and upper_inf(v.valid_period);
