-- Purpose: the standing features of a map at an instant on the road, as the database knew it at another instant.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest); max_rows.
-- Columns: feature_id, version, category, easting_m, northing_m, height_m, cov_* (m^2), cone_height_m, cone_height_sigma_m,
-- existence_probability, observation_count, first_seen_ns, last_seen_ns, valid_from, valid_to (null while open), seen_count,
-- missed_count (drives until then). existence_probability is that after the last drive that looked for it.
select
    v.feature_id, v.version, v.category,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    v.cone_height_m, v.cone_height_sigma_m,
    coalesce(e.existence_after, v.existence_probability) as existence_probability,
    v.observation_count, v.first_seen_ns, v.last_seen_ns,
    lower(v.valid_period) as valid_from,
    upper(v.valid_period) as valid_to,
    e.seen_count, e.missed_count
from conetl.map_as_of(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) v
cross join lateral conetl.feature_evidence(v.feature_id, v.version, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) e
order by v.feature_id
limit %(max_rows)s;
