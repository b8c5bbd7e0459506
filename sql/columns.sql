-- Columns that several statements share: `{{state columns}}` is replaced by the list `state` below, `{{state columns of v}}` by the
-- same with v instead of x. A new column of features or deltas is added here.
-- state: what feature_version, and the stages from which it is filled, hold of the state of a feature.
-- feature: what is read of a version as MapFeature (metres, m^2, UTC nanoseconds), without existence_probability.
-- change: what a delta and its stages hold besides versions and changeset.
-- sigma: standard deviation (m) of a version or track along the major axis of its horizontal error ellipse.
-- marking: shape of a lane marking for the web view (conetl.marking_json); null of point objects.
-- receipt: what is read as Receipt.
-- frame_pair: what is read as FramePair and its Pose.
-- evidence: not columns, but what ogc.page joins to p, a page of features or lane markings: n (counts of drives) and e (existence
-- after a miss), until $7 to_at as known at $8 known_at. It is that of conetl.feature_evidence, looked up for all items at once;
-- existence after a miss only where there is a miss. The full join finds what a left join would, because n has no other
-- features, but it is always hashed or merged, where a planner who expects one item would read n once per item.

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

-- name: change
x.kind, x.track_index, x.changed_at_ns, x.changed_at, x.shift_m,
x.other_feature_id, x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty

-- name: sigma
sqrt((x.cov_xx + x.cov_yy) / 2 + sqrt(((x.cov_xx - x.cov_yy) / 2) ^ 2 + x.cov_xy ^ 2))

-- name: marking
conetl.marking_json(x.line, x.line_cov, x.width_m, x.width_sigma_m, x.colour, x.pattern, x.dash_m, x.gap_m)

-- name: receipt
x.attempt_id, x.map_name, x.drive_path, x.drive_id, x.header_sha256, x.analysis_sha256, x.content_sha256, x.state, x.reason,
x.may_pass, x.changeset_id, x.frame_pairs, x.seconds, x.flow_run_id, x.host, x.at

-- name: frame_pair
x.frame_index, x.left_path, x.right_path, x.captured_at_ns,
array[ST_X(x.geom), ST_Y(x.geom), ST_Z(x.geom)] as map_t_body_m, x.map_r_body, x.sigma_enu_m, x.sigma_rpy_rad, x.detail

-- name: evidence
full join (
    select
        x.feature_id,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer as missed_count,
        count(*) filter (
            where x.kind not in ('missed', 'removed', 'merged') and x.changeset_id not in (
                select i.changeset_id from conetl.drive d join conetl.changeset i using (drive_uuid) where d.kind <> 'drive'
            )
        )::integer as seen_count
    from page p
    join conetl.feature f on f.feature_id = p.feature_id and f.map_id > 0
    join conetl.delta x on x.cell = f.cell and x.feature_id = f.feature_id
    where x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
    group by x.feature_id
) n on n.feature_id = p.feature_id
cross join lateral (
    select
        case when n.missed_count > 0 then (
            select x.existence_after
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.cell = conetl.cell_of(p.feature_id) and x.feature_id = p.feature_id and x.old_version = p.version
            and x.kind = 'missed'
            and x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
            order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            limit 1
        ) end as existence_after
) e
