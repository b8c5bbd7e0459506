-- Purpose: the standing features of a map at an instant on the road, as the database knew it at another instant.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest);
-- west_m, south_m, east_m, north_m (map CRS; all null: everywhere); srid.
-- Columns: as MapFeature (metres, m^2, UTC nanoseconds), then valid_from, valid_to (null while open), changeset_id,
-- seen_count, missed_count (drives until then; an import saw nothing). existence_probability is that after the last drive that looked for it.
-- Evidence is counted for all features at once: a call of conetl.feature_evidence for each takes several times as long.
with v as materialized (
    select v.*
    from conetl.map_as_of(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) v
    where
        %(west_m)s::float8 is null
        or v.geom && ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
),
evidence as (
    select
        v.feature_id,
        count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive')::integer as seen_count,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer as missed_count,
        (
            array_agg(
                x.existence_after
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            ) filter (where x.kind = 'missed' and x.old_version = v.version)
        )[1] as existence_after
    from v
    join conetl.delta x using (cell, feature_id)
    join conetl.changeset c on c.changeset_id = x.changeset_id
    join conetl.drive d on d.drive_uuid = c.drive_uuid
    where x.changed_at <= %(valid_at)s::timestamptz and x.system_period @> %(known_at)s::timestamptz
    group by v.feature_id
)
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, coalesce(e.existence_after, v.existence_probability), v.observation_count,
    v.first_seen_ns, v.last_seen_ns, array_send(v.calibrations) || array_send(v.shared_jacobian_m),
    lower(v.valid_period), upper(v.valid_period), v.changeset_id,
    coalesce(e.seen_count, 0) as seen_count,
    coalesce(e.missed_count, 0) as missed_count
from v
left join evidence e using (feature_id)
order by v.feature_id;
