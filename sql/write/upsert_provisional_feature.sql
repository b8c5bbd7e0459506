-- Purpose: a cone as the drive that is being watched shows it now. Parameters: watch_id, feature_index, map_name, srid, east_m, north_m,
-- height_m, cov_xx ... cov_zz (m^2: cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz), cone_height_m, existence_probability,
-- observation_count, first_seen_ns, last_seen_ns; reach_m: the nearest standing feature of the map within it may be the same cone.
insert into conetl.provisional_feature (
    watch_id, feature_index, srid, geom, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, cone_height_m, existence_probability,
    observation_count, first_seen_ns, last_seen_ns, near_feature_id
)
select
    %(watch_id)s, %(feature_index)s, %(srid)s, p.geom, %(cov_xx)s, %(cov_xy)s, %(cov_xz)s, %(cov_yy)s, %(cov_yz)s, %(cov_zz)s,
    %(cone_height_m)s, %(existence_probability)s, %(observation_count)s, %(first_seen_ns)s, %(last_seen_ns)s,
    (
        select f.feature_id
        from conetl.current_feature f
        where f.map_name = %(map_name)s and f.srid = %(srid)s and f.geom && ST_Expand(p.geom, %(reach_m)s)
        and ST_Distance(f.geom, p.geom) <= %(reach_m)s
        order by ST_Distance(f.geom, p.geom), f.feature_id
        limit 1
    )
from (select ST_SetSRID(ST_MakePoint(%(east_m)s, %(north_m)s, %(height_m)s), %(srid)s) as geom) p
on conflict (watch_id, feature_index) do update
set geom = excluded.geom, cov_xx = excluded.cov_xx, cov_xy = excluded.cov_xy, cov_xz = excluded.cov_xz, cov_yy = excluded.cov_yy,
    cov_yz = excluded.cov_yz, cov_zz = excluded.cov_zz, cone_height_m = excluded.cone_height_m,
    existence_probability = excluded.existence_probability, observation_count = excluded.observation_count,
    first_seen_ns = excluded.first_seen_ns, last_seen_ns = excluded.last_seen_ns, near_feature_id = excluded.near_feature_id,
    updated_at = clock_timestamp();
