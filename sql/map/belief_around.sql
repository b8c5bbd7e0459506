-- Purpose: everything believed now about the features that ever stood around the paths of some drives.
-- Parameters: drive_uuids (uuid[], of one map). Columns: as FeatureVersion, then version_row_id, drive_uuid, and the drive's place
-- in the fold: captured_from_ns, content_sha256, idempotency_key.
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    array_send(v.calibrations) || array_send(v.shared_jacobian_m),
    v.changeset_id, v.present or v.suppressed, v.suppressed, v.valid_from_ns,
    lead(v.valid_from_ns) over (partition by v.feature_id order by lower(v.valid_period)),
    v.version_row_id, d.drive_uuid, d.captured_from_ns, d.content_sha256, c.idempotency_key
from conetl.feature_version v
join conetl.changeset c on c.changeset_id = v.changeset_id
join conetl.drive d on d.drive_uuid = c.drive_uuid
where upper_inf(v.system_period)
and (v.cell, v.feature_id) in (
    select w.cell, w.feature_id
    from conetl.drive a
    cross join lateral conetl.pieces(a.area) piece
    join conetl.feature_version w on w.map_id = a.map_id and w.geom && piece and ST_Intersects(w.geom, piece)
    where a.drive_uuid = any(%(drive_uuids)s) and upper_inf(w.system_period)
)
order by v.feature_id, lower(v.valid_period);
