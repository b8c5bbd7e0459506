-- Purpose: where and when a map has anything, as believed now. Parameters: map_name.
-- Columns: west_m, south_m, east_m, north_m (map CRS), first_at, last_at (timestamptz); null for an empty map.
select
    min(ST_X(v.geom)) as west_m, min(ST_Y(v.geom)) as south_m, max(ST_X(v.geom)) as east_m, max(ST_Y(v.geom)) as north_m,
    min(lower(v.valid_period)) as first_at, max(greatest(lower(v.valid_period), to_timestamp(v.last_seen_ns / 1e9))) as last_at
from conetl.feature_version v
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and upper_inf(v.system_period);
