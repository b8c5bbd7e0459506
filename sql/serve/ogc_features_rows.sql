-- Purpose: features of a map as conetl_ogc.features has them, of some versions only; tipg chooses and orders their columns.
-- Parameters: $1 map name; $2, $3, $4 from_at, to_at, known_at (text of instants); $5 rows of the versions.
-- Columns: those of conetl_ogc.features.
select
    s.feature_id, s.version, s.category, coalesce(e.existence_after, s.existence_probability) as existence_probability,
    s.easting_m, s.northing_m, s.height_m, s.sigma_east_m, s.sigma_north_m, s.sigma_height_m, s.cov_xy_m2,
    s.cone_height_m, s.cone_height_sigma_m, s.observation_count, e.seen_count, e.missed_count,
    s.first_seen_at, s.last_seen_at, s.valid_from, s.valid_to, s.geom
from conetl_ogc.standing($1, $2::text::timestamptz, $3::text::timestamptz, $4::text::timestamptz) s
cross join lateral conetl.feature_evidence(s.feature_id, s.version, $3::text::timestamptz, $4::text::timestamptz) e
where s.version_row_id = any($5::bigint[]);
