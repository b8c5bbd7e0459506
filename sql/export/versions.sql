-- Purpose: feature versions of a map as other programs get them: the map of an instant, or its whole history.
-- Parameters: map_id; every_version (false: only what stood on the road at valid_at); valid_at (timestamptz; 'infinity' = latest);
-- known_at (timestamptz; 'infinity' = what is believed now; null: all that was ever believed); with_change: tell what made each
-- version (else change and shift_m are null); spatial_order (Hilbert curve, PostGIS's order of geometries), time_order (both false:
-- by feature_id).
-- Columns: the exported names (metres, m^2, probabilities, UTC); *_ns are nanoseconds since 1970. In this order in every file.
-- seen_count, missed_count: drives that saw the feature and that looked in vain, until valid_at (of a version: until it ended), and
-- existence_probability is that after the last of them, all as the version was believed last.
with told as not materialized (  -- by the drives of the map until the instant, for all features at once: a call a feature takes too long
    select x.feature_id, x.kind, x.old_version, x.existence_after, d.kind as source,
        d.captured_from_ns, d.content_sha256, c.idempotency_key
    from conetl.changeset c
    join conetl.delta x using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where not %(every_version)s and c.map_id = %(map_id)s
    and x.changed_at <= %(valid_at)s::timestamptz and x.system_period @> %(known_at)s::timestamptz
),

counts as (
    select
        feature_id,
        count(*) filter (where kind not in ('missed', 'removed', 'merged') and source = 'drive')::integer as seen_count,
        count(*) filter (where kind in ('missed', 'removed'))::integer as missed_count
    from told
    group by feature_id
),

doubts as (
    select distinct on (feature_id, old_version) feature_id, old_version as version, existence_after
    from told
    where kind = 'missed'
    order by feature_id, old_version, captured_from_ns desc, content_sha256 collate "C" desc, idempotency_key collate "C" desc
),

told_of_versions as not materialized (  -- of a history: by the drives until each version ended, as each version was believed last
    select
        v.version_row_id, v.version, x.kind, x.old_version, x.existence_after, d.kind as source,
        d.captured_from_ns, d.content_sha256, c.idempotency_key
    from conetl.feature_version v
    join conetl.delta x using (feature_id)
    join conetl.changeset c on c.changeset_id = x.changeset_id
    join conetl.drive d using (drive_uuid)
    where %(every_version)s and v.map_id = %(map_id)s
    and x.changed_at <= coalesce(upper(v.valid_period) - interval '1 microsecond', 'infinity')
    and x.system_period @> coalesce(
        %(known_at)s::timestamptz, upper(v.system_period) - interval '1 microsecond', 'infinity'
    )
),

counts_of_versions as (
    select
        version_row_id,
        count(*) filter (where kind not in ('missed', 'removed', 'merged') and source = 'drive')::integer as seen_count,
        count(*) filter (where kind in ('missed', 'removed'))::integer as missed_count
    from told_of_versions
    group by version_row_id
),

doubts_of_versions as (
    select distinct on (version_row_id) version_row_id, existence_after
    from told_of_versions
    where kind = 'missed' and old_version = version
    order by version_row_id, captured_from_ns desc, content_sha256 collate "C" desc, idempotency_key collate "C" desc
)

select
    v.feature_id,
    v.version,
    v.category,
    coalesce(b.existence_after, vb.existence_after, v.existence_probability) as existence_probability,
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
    coalesce(n.seen_count, vn.seen_count, 0) as seen_count,
    coalesce(n.missed_count, vn.missed_count, 0) as missed_count,
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
from conetl.feature_version v
left join conetl.delta x on %(with_change)s and x.changeset_id = v.changeset_id and x.feature_id = v.feature_id
    and x.new_version = v.version and x.system_period @> lower(v.system_period)
left join counts n on n.feature_id = v.feature_id
left join doubts b on b.feature_id = v.feature_id and b.version = v.version
left join counts_of_versions vn on vn.version_row_id = v.version_row_id
left join doubts_of_versions vb on vb.version_row_id = v.version_row_id
where v.map_id = %(map_id)s
and (%(every_version)s or (v.present and v.valid_period @> %(valid_at)s::timestamptz))
and (%(known_at)s::timestamptz is null or v.system_period @> %(known_at)s::timestamptz)
order by
    case when %(spatial_order)s then v.geom end,
    case when %(time_order)s then lower(v.valid_period) end,
    v.feature_id, v.version, lower(v.system_period);
