-- Columns that several statements share: `{{state columns}}` is replaced by the list `state` below, `{{state columns of v}}` by the
-- same with v instead of x. GROUPS of model/columns.py are used likewise.
-- state: what feature_version, and the stage from which it is filled, hold of the state of a feature.
-- feature: what is read of a version as MapFeature (metres, m^2, UTC nanoseconds).
-- change: what a delta and its stage hold besides versions and changeset.
-- sigma: standard deviation (m) of a track along the major axis of its horizontal error ellipse.
-- marking: shape of a lane marking for the web view, of conetl.feature_state; null of point objects. line_m counts from the
-- parameter origin_m.
-- receipt: what is read as Receipt.
-- frame_pair: what is read as FramePair and its Pose.

-- name: state
{{stored columns of x}}, x.geom, x.cov_xx, x.cov_xy, x.cov_xz, x.cov_yy, x.cov_yz, x.cov_zz, x.centre_geom,
x.first_missed_ns, x.first_seen_ns, x.last_seen_ns, x.calibrations, x.shared_jacobian_m, x.line, x.line_cov

-- name: feature
x.feature_id, x.version, {{stored columns of x}}, array[ST_X(x.geom), ST_Y(x.geom), ST_Z(x.geom)] as xyz_m,
array[x.cov_xx, x.cov_xy, x.cov_xz, x.cov_yy, x.cov_yz, x.cov_zz] as cov_m2,
array[ST_X(x.centre_geom), ST_Y(x.centre_geom), ST_Z(x.centre_geom)] as centre_xyz_m,
x.first_missed_ns, x.first_seen_ns, x.last_seen_ns,
array_send(x.calibrations) || array_send(x.shared_jacobian_m) as shared_jacobian,
ST_AsBinary(x.line, 'NDR') as line, x.line_cov

-- name: change
x.kind, x.track_index, x.changed_at_ns, x.changed_at, x.shift_m,
x.other_feature_id, x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty

-- name: sigma
sqrt((x.cov_xx + x.cov_yy) / 2 + sqrt(((x.cov_xx - x.cov_yy) / 2) ^ 2 + x.cov_xy ^ 2))

-- name: marking
case when x.line is not null then
    jsonb_build_object('line_m', (ST_AsGeoJSON(ST_Translate(
        x.line, -(%(origin_m)s::float8[])[1], -(%(origin_m)s::float8[])[2], -(%(origin_m)s::float8[])[3]
    ), 4)::jsonb) -> 'coordinates', 'sigma_lateral_m', x.sigma_lateral_m)
    || (select to_jsonb(p) from (select {{paint columns of x}}) p)
end

-- name: receipt
x.attempt_id, x.map_name, x.drive_path, x.drive_id, x.header_sha256, x.analysis_sha256, x.content_sha256, x.state, x.reason,
x.may_pass, x.changeset_id, x.frame_pairs, x.seconds, x.flow_run_id, x.host, x.at

-- name: frame_pair
x.frame_index, x.left_path, x.right_path, x.captured_at_ns,
array[ST_X(x.geom), ST_Y(x.geom), ST_Z(x.geom)] as map_t_body_m, x.map_r_body, x.sigma_enu_m, x.sigma_rpy_rad, x.detail
