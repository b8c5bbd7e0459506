-- Purpose: the standing features of a map, as of now.
-- Parameters: map_name; west_m, south_m, east_m, north_m (map CRS; all null: everywhere); srid.
-- Columns: as MapFeature: metres, m^2, UTC nanoseconds; at last calibrations and shared_jacobian_m as PostgreSQL sends them, one after the other.
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    array_send(v.calibrations) || array_send(v.shared_jacobian_m)
from conetl.current_feature v
where v.map_name = %(map_name)s
and (
    %(west_m)s::float8 is null
    or v.geom && ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
)
order by v.feature_id;
