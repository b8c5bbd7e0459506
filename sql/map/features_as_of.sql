-- Purpose: the standing features of a map at an instant on the road, as the database knew it at another instant.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest);
-- west_m, south_m, east_m, north_m (map CRS; all null: everywhere); srid.
-- Columns: as MapFeature (metres, m^2, UTC nanoseconds), then valid_from, valid_to (null while open), changeset_id,
-- seen_count, missed_count (drives until then). existence_probability is that after the last drive that looked for it.
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, coalesce(e.existence_after, v.existence_probability), v.observation_count,
    v.first_seen_ns, v.last_seen_ns,
    lower(v.valid_period), upper(v.valid_period), v.changeset_id, e.seen_count, e.missed_count
from conetl.map_as_of(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) v
cross join lateral conetl.feature_evidence(v.feature_id, v.version, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) e
where
    %(west_m)s::float8 is null
    or v.geom && ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
order by v.feature_id;
