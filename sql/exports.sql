-- What exports and QGIS projects read.

-- name: snapshot
-- The open transaction reads a single state of the database. Must come before its first query.
set transaction isolation level repeatable read, read only;

-- name: memory
-- Memory for each sort and each join of the open transaction (a join may use twice as much) before it uses the disk.
-- Parameters: work_mem (for example '64MB').
set local work_mem = %(work_mem)s;

-- name: has_lines
-- Whether a map has or had lane markings. Parameters: map_id. Columns: found.
select exists (select from conetl.feature_version v where v.map_id = %(map_id)s and v.line is not null) as found;

-- name: has_class
-- Whether a map has or had objects of a class. Parameters: map_id, category. Columns: found.
select exists (
    select from conetl.feature_version v where v.map_id = %(map_id)s and v.category = %(category)s
) as found;

-- name: facts
-- What a manifest states about a map. Parameters: map_name.
-- Columns: licence (null where none was set), changeset_count, schema_version (the last migration).
select
    m.licence,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    (select max(s.name) from conetl.schema_migration s) as schema_version
from conetl.map m
where m.map_name = %(map_name)s;

-- name: versions
-- Feature versions of a map for other programs: the map of an instant, or its whole history.
-- Parameters: map_id; every_version (false: only what stood on the road at valid_at); valid_at (timestamptz; 'infinity'
-- = latest); known_at (timestamptz; 'infinity' = current versions; null: also superseded ones); with_change: what made
-- each version (else change and shift_m are null); west_m, south_m, east_m, north_m (map CRS; all null: everywhere) and
-- srid; spatial_order (Hilbert curve, PostGIS's order of geometries),
-- time_order (both false: by feature_id); lines: lane markings instead of point objects; category (null: all).
-- Columns: the exported names (metres, m^2, probabilities, UTC) in the order of every file; the position of a line is that
-- of its middle vertex, and line its well-known binary in the map's CRS, in hexadecimal digits. seen_count, missed_count:
-- drives that saw or missed the feature until valid_at (of a version: until it ended), and existence_probability
-- is the value after the last of them, all as of the end of the version's system period.
with judged as not materialized (  -- until the instant; for all features at once, because a call per feature takes too long
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
    from judged
    group by feature_id
),
doubts as (
    select distinct on (feature_id, old_version) feature_id, old_version as version, existence_after
    from judged
    where kind = 'missed'
    order by feature_id, old_version, captured_from_ns desc, content_sha256 collate "C" desc, idempotency_key collate "C" desc
),
judged_versions as not materialized (  -- of a history: until each version ended, as of the end of its system period
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
    from judged_versions
    group by version_row_id
),
doubts_of_versions as (
    select distinct on (version_row_id) version_row_id, existence_after
    from judged_versions
    where kind = 'missed' and old_version = version
    order by version_row_id, captured_from_ns desc, content_sha256 collate "C" desc, idempotency_key collate "C" desc
)
select
    v.feature_id, v.version, v.category,
    coalesce(b.existence_after, vb.existence_after, v.existence_probability) as existence_probability,
    v.cone_height_m as height_m, sqrt(v.cov_xx) as sigma_e_m, sqrt(v.cov_yy) as sigma_n_m, sqrt(v.cov_zz) as sigma_u_m,
    'epoch'::timestamptz + v.first_seen_ns / 1000 * interval '1 microsecond' as first_seen_at,
    'epoch'::timestamptz + v.last_seen_ns / 1000 * interval '1 microsecond' as last_seen_at, v.observation_count,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.changeset_id,
    coalesce(n.seen_count, vn.seen_count, 0) as seen_count, coalesce(n.missed_count, vn.missed_count, 0) as missed_count,
    v.cone_height_sigma_m as height_sigma_m, v.cov_xy as cov_en_m2, v.cov_xz as cov_eu_m2, v.cov_yz as cov_nu_m2,
    x.kind as change, x.shift_m, v.present, v.suppressed,
    lower(v.system_period) as system_from, upper(v.system_period) as system_to,
    v.width_m, v.width_sigma_m, v.colour, v.pattern, v.dash_m, v.gap_m,
    conetl.lateral_sigma_m(v.line, v.line_cov) as sigma_lateral_m, ST_3DLength(v.line) as length_m,
    encode(ST_AsBinary(v.line), 'hex') as line,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as ellipsoidal_height_m
from conetl.feature_version v
left join conetl.delta x on %(with_change)s and x.changeset_id = v.changeset_id and x.feature_id = v.feature_id
    and x.new_version = v.version and x.system_period @> lower(v.system_period)
left join counts n on n.feature_id = v.feature_id
left join doubts b on b.feature_id = v.feature_id and b.version = v.version
left join counts_of_versions vn on vn.version_row_id = v.version_row_id
left join doubts_of_versions vb on vb.version_row_id = v.version_row_id
where v.map_id = %(map_id)s and (v.line is not null) = %(lines)s
and (%(category)s::text is null or v.category = %(category)s)
and (%(every_version)s or (v.present and v.valid_period @> %(valid_at)s::timestamptz))
and (%(known_at)s::timestamptz is null or v.system_period @> %(known_at)s::timestamptz)
and (
    %(west_m)s::float8 is null
    or v.geom && ST_Expand(
        ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s),
        case when %(lines)s then 10 else 0 end  -- no stretch is longer
    )
    and (
        v.line is null
        or v.line && ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
    )
)
order by
    case when %(spatial_order)s then v.geom end,
    case when %(time_order)s then lower(v.valid_period) end,
    v.feature_id, v.version, lower(v.system_period);

-- name: changes
-- Features that differ between two instants on the road, both as the database knew them at one instant.
-- Parameters: map_name; from_valid_at, to_valid_at, known_at (timestamptz; 'infinity' = latest); moved_from_m: a
-- larger horizontal shift is a move, a smaller one a better measurement; line_moved_from_m: the same for lane markings,
-- across the line; spatial_order, time_order (both false: by feature_id); lines: lane markings instead of point objects;
-- category (null: all).
-- Columns: as exports.versions, of the later state (of removed features: of the earlier one, with valid_to when they
-- were removed, whatever confirmed them in between), change (added, moved, confirmed, removed) and shift_m;
-- old_easting_m, old_northing_m, old_height_m, old_version: of the earlier state (null for added); seen_count,
-- missed_count: drives that saw or missed the feature until to_valid_at.
with before as (
    select f.feature_id, f as state
    from conetl.map_as_of(%(map_name)s, %(from_valid_at)s::timestamptz, %(known_at)s::timestamptz) f
),
after as (
    select f.feature_id, f as state
    from conetl.map_as_of(%(map_name)s, %(to_valid_at)s::timestamptz, %(known_at)s::timestamptz) f
),
both_states as (
    select b.state as old, a.state as new, coalesce(a.state, b.state) as state
    from before b
    full outer join after a using (feature_id)
    where b.feature_id is null or a.feature_id is null or (a.state).version_row_id <> (b.state).version_row_id
)
select
    (c.state).feature_id, (c.state).version, (c.state).category,
    coalesce(e.existence_after, (c.state).existence_probability) as existence_probability,
    (c.state).cone_height_m as height_m, sqrt((c.state).cov_xx) as sigma_e_m, sqrt((c.state).cov_yy) as sigma_n_m,
    sqrt((c.state).cov_zz) as sigma_u_m,
    'epoch'::timestamptz + (c.state).first_seen_ns / 1000 * interval '1 microsecond' as first_seen_at,
    'epoch'::timestamptz + (c.state).last_seen_ns / 1000 * interval '1 microsecond' as last_seen_at, (c.state).observation_count,
    lower((c.state).valid_period) as valid_from,
    case
        when (c.new).feature_id is null then (
            select max(upper(v.valid_period))
            from conetl.feature_version v
            where v.cell = (c.old).cell and v.feature_id = (c.old).feature_id and v.present
            and lower(v.valid_period) <= %(to_valid_at)s::timestamptz and v.system_period @> %(known_at)s::timestamptz
        )
        else upper((c.state).valid_period)
    end as valid_to,
    (c.state).changeset_id, e.seen_count, e.missed_count, (c.state).cone_height_sigma_m as height_sigma_m,
    (c.state).cov_xy as cov_en_m2, (c.state).cov_xz as cov_eu_m2, (c.state).cov_yz as cov_nu_m2,
    case
        when (c.old).feature_id is null then 'added'
        when (c.new).feature_id is null then 'removed'
        when ST_Distance((c.old).geom, (c.new).geom) > %(moved_from_m)s and (c.old).line is null then 'moved'
        when ST_Distance((c.old).line, (c.new).geom) > %(line_moved_from_m)s then 'moved'
        else 'confirmed'
    end as change,
    ST_Distance(coalesce((c.old).line, (c.old).geom), (c.new).geom) as shift_m, (c.old).version as old_version,
    ST_X((c.old).geom) as old_easting_m, ST_Y((c.old).geom) as old_northing_m, ST_Z((c.old).geom) as old_height_m,
    (c.state).width_m, (c.state).width_sigma_m, (c.state).colour, (c.state).pattern, (c.state).dash_m, (c.state).gap_m,
    conetl.lateral_sigma_m((c.state).line, (c.state).line_cov) as sigma_lateral_m, ST_3DLength((c.state).line) as length_m,
    encode(ST_AsBinary((c.state).line), 'hex') as line,
    ST_X((c.state).geom) as easting_m, ST_Y((c.state).geom) as northing_m, ST_Z((c.state).geom) as ellipsoidal_height_m
from both_states c
cross join lateral conetl.feature_evidence(
    (c.state).feature_id, (c.state).version, %(to_valid_at)s::timestamptz, %(known_at)s::timestamptz
) e
where ((c.state).line is not null) = %(lines)s and (%(category)s::text is null or (c.state).category = %(category)s)
order by
    case when %(spatial_order)s then (c.state).geom end,
    case when %(time_order)s then lower((c.state).valid_period) end,
    (c.state).feature_id;

-- name: qgis_extent
-- Extent in space and time of a map's current versions. Parameters: map_name.
-- Columns: west_m, south_m, east_m, north_m (map CRS), first_at, last_at (timestamptz); null for an empty map.
select
    min(ST_X(v.geom)) as west_m, min(ST_Y(v.geom)) as south_m, max(ST_X(v.geom)) as east_m, max(ST_Y(v.geom)) as north_m,
    min(lower(v.valid_period)) as first_at, max(greatest(lower(v.valid_period), to_timestamp(v.last_seen_ns / 1e9))) as last_at
from conetl.feature_version v
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and upper_inf(v.system_period);

-- name: qgis_now
-- Layer of a QGIS project: the standing point objects, with the last change of each. Parameters: map_name.
-- Columns: as below (metres, UTC); sigma_m along the major axis of the error ellipse; seen_count, missed_count: drives that saw or
-- missed it, existence_probability is the value after them.
select
    v.version_row_id, v.feature_id::text as feature_id, v.version, x.kind as change, v.category,
    coalesce(e.existence_after, v.existence_probability) as existence_probability, e.seen_count, e.missed_count,
    v.cone_height_m as object_height_m, ST_Z(v.geom) as ellipsoidal_height_m,
    {{sigma columns of v}} as sigma_m,
    v.observation_count, to_timestamp(v.first_seen_ns / 1e9) as first_seen_at, to_timestamp(v.last_seen_ns / 1e9) as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.geom
from conetl.feature_version v
join conetl.map m using (map_id)
join conetl.delta x on x.changeset_id = v.changeset_id and x.feature_id = v.feature_id and upper_inf(x.system_period)
cross join lateral conetl.feature_evidence(v.feature_id, v.version) e
where m.map_name = %(map_name)s and upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present and v.line is null;

-- name: qgis_markings
-- Layer of a QGIS project: the standing lane markings, with the last change of each. Parameters: map_name.
-- Columns: as below (metres, UTC); sigma_lateral_m is that across the line; seen_count, missed_count and
-- existence_probability as in qgis_now.
select
    v.version_row_id, v.feature_id::text as feature_id, v.version, x.kind as change, v.category,
    coalesce(e.existence_after, v.existence_probability) as existence_probability, e.seen_count, e.missed_count,
    v.width_m, v.width_sigma_m, v.colour, v.pattern, v.dash_m, v.gap_m,
    conetl.lateral_sigma_m(v.line, v.line_cov) as sigma_lateral_m, ST_3DLength(v.line) as length_m,
    v.observation_count, to_timestamp(v.first_seen_ns / 1e9) as first_seen_at, to_timestamp(v.last_seen_ns / 1e9) as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.line as geom
from conetl.feature_version v
join conetl.map m using (map_id)
join conetl.delta x on x.changeset_id = v.changeset_id and x.feature_id = v.feature_id and upper_inf(x.system_period)
cross join lateral conetl.feature_evidence(v.feature_id, v.version) e
where m.map_name = %(map_name)s and upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present
and v.line is not null;

-- name: qgis_over_time
-- Layer of a QGIS project: all current versions of point objects, for the temporal controller.
-- Parameters: map_name. Columns: as below (metres, UTC); sigma_m along the major axis of the error ellipse.
select
    v.version_row_id, v.feature_id::text as feature_id, v.version, x.kind as change, v.category, v.existence_probability,
    v.cone_height_m as object_height_m, ST_Z(v.geom) as ellipsoidal_height_m,
    {{sigma columns of v}} as sigma_m,
    v.observation_count,
    to_timestamp(v.first_seen_ns / 1e9) as first_seen_at, to_timestamp(v.last_seen_ns / 1e9) as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.geom
from conetl.feature_version v
join conetl.map m using (map_id)
join conetl.delta x on x.changeset_id = v.changeset_id and x.feature_id = v.feature_id and upper_inf(x.system_period)
where m.map_name = %(map_name)s and upper_inf(v.system_period) and v.line is null
and (v.present or x.kind in ('removed', 'merged'));
