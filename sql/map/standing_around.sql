-- Purpose: the features that stand around a drive's path as its map knows them now, suppressed ones too: what the drive is compared
-- with where no later drive was there.
-- Parameters: drive_uuid. Columns: as FeatureVersion.
select distinct on (v.feature_id)
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    array_send(v.calibrations) || array_send(v.shared_jacobian_m),
    v.changeset_id, true, v.suppressed, v.valid_from_ns, null::bigint
from conetl.drive d
cross join lateral conetl.pieces(d.area) piece
join conetl.feature_version v on v.map_id = d.map_id and v.geom && piece and ST_Intersects(v.geom, piece)
where d.drive_uuid = %(drive_uuid)s
and upper_inf(v.system_period) and upper_inf(v.valid_period) and (v.present or v.suppressed)
order by v.feature_id;
