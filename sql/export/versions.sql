-- Purpose: feature versions of a map as other programs get them: the map of an instant, or its whole history.
-- Parameters: map_name; every_version (false: only what stood on the road at valid_at); valid_at (timestamptz; 'infinity' = latest);
-- known_at (timestamptz; 'infinity' = what is believed now; null: all that was ever believed); with_change: tell what made each
-- version (else change and shift_m are null); spatial_order (Hilbert curve, PostGIS's order of geometries), time_order (both false:
-- by feature_id).
-- Columns: the exported names (metres, m^2, probabilities, UTC); *_ns are nanoseconds since 1970. In this order in every file.
select
    v.feature_id,
    v.version,
    v.category,
    v.existence_probability,
    v.cone_height_m as height_m,
    sqrt(v.cov_xx) as sigma_e_m,
    sqrt(v.cov_yy) as sigma_n_m,
    sqrt(v.cov_zz) as sigma_u_m,
    v.first_seen_ns,
    v.last_seen_ns,
    v.observation_count,
    lower(v.valid_period) as valid_from,
    upper(v.valid_period) as valid_to,
    v.changeset_id,
    v.cone_height_sigma_m as height_sigma_m,
    v.cov_xy as cov_en_m2,
    v.cov_xz as cov_eu_m2,
    v.cov_yz as cov_nu_m2,
    x.kind as change,
    x.shift_m,
    v.present,
    v.suppressed,
    lower(v.system_period) as system_from,
    upper(v.system_period) as system_to,
    ST_X(v.geom) as easting_m,
    ST_Y(v.geom) as northing_m,
    ST_Z(v.geom) as ellipsoidal_height_m
from conetl.map m
join conetl.feature_version v using (map_id)
left join conetl.delta x on %(with_change)s and x.changeset_id = v.changeset_id and x.feature_id = v.feature_id
    and x.new_version = v.version and x.system_period @> lower(v.system_period)
where m.map_name = %(map_name)s
and (%(every_version)s or (v.present and v.valid_period @> %(valid_at)s::timestamptz))
and (%(known_at)s::timestamptz is null or v.system_period @> %(known_at)s::timestamptz)
order by
    case when %(spatial_order)s then v.geom end,
    case when %(time_order)s then lower(v.valid_period) end,
    v.feature_id, v.version, lower(v.system_period);
