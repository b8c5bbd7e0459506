-- Purpose: what an imported map states. Parameters: drive_uuid. Columns: as MapFeature of version 1, then valid_from_ns.
select
    s.feature_id, 1, s.category, ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom),
    s.cov_xx, s.cov_xy, s.cov_xz, s.cov_yy, s.cov_yz, s.cov_zz,
    ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom) + s.cone_height_m / 2,
    s.cone_height_m, s.cone_height_sigma_m, s.existence_probability, s.observation_count, s.first_seen_ns, s.last_seen_ns,
    null::bytea, s.valid_from_ns
from conetl.statement s
where s.drive_uuid = %(drive_uuid)s
order by s.statement_index;
