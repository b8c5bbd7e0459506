-- Columns that several statements share: `{{state columns}}` stands for the list `state` below, `{{state columns of v}}` for the
-- same with v in place of x. A new column of features is added here.
-- state: what feature_version, and the stages from which it is filled, hold of the state of a feature.
-- feature: what is read of a version as MapFeature (metres, m^2, UTC nanoseconds), but for existence_probability.

-- name: state
x.category, x.geom, x.cov_xx, x.cov_xy, x.cov_xz, x.cov_yy, x.cov_yz, x.cov_zz,
x.centre_geom, x.cone_height_m, x.cone_height_sigma_m, x.existence_probability, x.observation_count,
x.first_seen_ns, x.last_seen_ns, x.calibrations, x.shared_jacobian_m,
x.line, x.line_cov, x.width_m, x.width_sigma_m, x.colour, x.pattern, x.dash_m, x.gap_m

-- name: feature
x.feature_id, x.version, x.category, array[ST_X(x.geom), ST_Y(x.geom), ST_Z(x.geom)] as xyz_m,
array[x.cov_xx, x.cov_xy, x.cov_xz, x.cov_yy, x.cov_yz, x.cov_zz] as cov_m2,
array[ST_X(x.centre_geom), ST_Y(x.centre_geom), ST_Z(x.centre_geom)] as centre_xyz_m,
x.cone_height_m, x.cone_height_sigma_m, x.observation_count, x.first_seen_ns, x.last_seen_ns,
array_send(x.calibrations) || array_send(x.shared_jacobian_m) as shared_jacobian,
ST_AsBinary(x.line, 'NDR') as line, x.line_cov, x.width_m, x.width_sigma_m, x.colour, x.pattern, x.dash_m, x.gap_m
