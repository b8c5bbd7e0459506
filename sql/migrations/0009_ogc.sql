-- Purpose: what OGC API Features and vector tiles read: the map as of an instant, and its changes between two.
--
-- Both functions only read, and are plain queries of one statement, so that PostgreSQL puts them into the query that calls them and a
-- filter, an order or a limit outside reaches the tables inside. Places come as longitude and latitude (EPSG:4326) with the map's
-- ellipsoidal height (m). GeoJSON prints billionths of a degree (a tenth of a millimetre), and so exact is the edge of a box:
-- a coordinate of an answer as the edge of a box finds that item.
--
-- A box has two forms, because an index knows a map's own CRS only: west, south, east, north (degrees, edges included; west > east goes
-- across 180 degrees) is what counts, and min_x_m .. max_y_m (map CRS) is a box around it that finds the rows. Without the second one
-- the answer is the same and every row of the map is looked at.

create schema conetl_ogc;
comment on schema conetl_ogc is 'Functions behind OGC API Features and vector tiles; read-only.';

-- Instants stand in a select of their own, so that their text is read once and not once a row. Belief and counts are those of conetl.feature_evidence, written out because a call per row costs five times as much.
-- Of an interval, the last version of each feature that stood within it.
create function conetl_ogc.features(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    easting_m float8, northing_m float8, height_m float8,
    sigma_east_m float8, sigma_north_m float8, sigma_height_m float8, cov_xy_m2 float8,
    cone_height_m float8, cone_height_sigma_m float8, observation_count integer, seen_count integer, missed_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry
)
language sql stable
as $$
    select
        v.feature_id, v.version, v.category,
        coalesce(
            (
                select x.existence_after
                from conetl.delta x
                join conetl.changeset c using (changeset_id)
                join conetl.drive d using (drive_uuid)
                where x.feature_id = v.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
                and x.kind = 'missed' and x.old_version = v.version
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
                limit 1
            ),
            v.existence_probability
        ),
        ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
        sqrt(v.cov_xx), sqrt(v.cov_yy), sqrt(v.cov_zz), v.cov_xy,
        v.cone_height_m, v.cone_height_sigma_m, v.observation_count,
        (
            select count(*)::integer
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.feature_id = v.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive'
        ),
        (
            select count(*)::integer
            from conetl.delta x
            where x.feature_id = v.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind in ('missed', 'removed')
        ),
        timestamptz 'epoch' + v.first_seen_ns / 1000 * interval '1 microsecond',
        timestamptz 'epoch' + v.last_seen_ns / 1000 * interval '1 microsecond',
        lower(v.valid_period), upper(v.valid_period),
        ST_Transform(v.geom, 4326)
    from conetl.map m
    join conetl.feature_version v using (map_id)
    where m.map_name = $1 and v.present
    and v.valid_period && (select tstzrange($2, $3, '[]')) and v.system_period @> (select $4)
    and (
        (select $2 = $3) or not exists (
            select from conetl.feature_version later
            where later.feature_id = v.feature_id and later.present and later.valid_period && (select tstzrange($2, $3, '[]'))
            and later.system_period @> (select $4) and lower(later.valid_period) > lower(v.valid_period)
        )
    )
    and v.geom && ST_MakeEnvelope($9, $10, $11, $12)
    and (
        ($5 <= -180 and $6 <= -90 and $7 >= 180 and $8 >= 90)
        or (
            ST_Y(ST_Transform(v.geom, 4326)) between $6 - 5e-10 and $8 + 5e-10
            and case
                when $5 <= $7 then ST_X(ST_Transform(v.geom, 4326)) between $5 - 5e-10 and $7 + 5e-10
                else ST_X(ST_Transform(v.geom, 4326)) >= $5 - 5e-10 or ST_X(ST_Transform(v.geom, 4326)) <= $7 + 5e-10
            end
        )
    )
$$;
comment on function conetl_ogc.features is 'The cones of a map that stood between two instants on the road, as the database knew it.';

-- Kinds as in the browser's comparison: moved from moved_from_m (m, on the ground) on, confirmed where only values are newer; the same
-- version is no change. A feature stands where it is afterwards, one that was removed where it was.
create function conetl_ogc.changes(
    map_name text,
    from_at timestamptz default '-infinity', known_from timestamptz default 'infinity',
    to_at timestamptz default 'infinity', known_to timestamptz default 'infinity', moved_from_m float8 default 0.5,
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30
)
returns table (
    feature_id uuid, kind text, changed_at timestamptz, shift_m float8, category text,
    easting_m float8, northing_m float8, height_m float8,
    old_easting_m float8, old_northing_m float8, old_height_m float8,
    existence_probability float8, observation_count integer, cone_height_m float8, version integer,
    geom geometry
)
language sql stable
as $$
    select
        c.feature_id, c.kind, c.changed_at, c.shift_m, c.category,
        ST_X(c.place), ST_Y(c.place), ST_Z(c.place),
        ST_X(c.old_place), ST_Y(c.old_place), ST_Z(c.old_place),
        c.existence_probability, c.observation_count, c.cone_height_m, c.version,
        ST_Transform(c.place, 4326)
    from (
        select
            a.feature_id,
            case
                when b.feature_id is null then 'added'
                when ST_Distance(a.geom, b.geom) >= $6 then 'moved'
                else 'confirmed'
            end as kind,
            lower(a.valid_period) as changed_at,
            ST_Distance(a.geom, b.geom) as shift_m,
            a.category, a.geom as place, b.geom as old_place, a.existence_probability, a.observation_count, a.cone_height_m, a.version
        from conetl.map m
        join conetl.feature_version a using (map_id)
        left join conetl.feature_version b
            on b.feature_id = a.feature_id and b.present
            and b.valid_period @> (select $2) and b.system_period @> (select $3)
        where m.map_name = $1 and a.present
        and a.valid_period @> (select $4) and a.system_period @> (select $5)
        and (b.feature_id is null or a.version <> b.version or not ST_Equals(a.geom, b.geom))
        and a.geom && ST_MakeEnvelope($11, $12, $13, $14)
        union all
        select
            b.feature_id, 'removed', upper(b.valid_period), null,
            b.category, b.geom, b.geom, b.existence_probability, b.observation_count, b.cone_height_m, b.version
        from conetl.map m
        join conetl.feature_version b using (map_id)
        where m.map_name = $1 and b.present
        and b.valid_period @> (select $2) and b.system_period @> (select $3)
        and b.geom && ST_MakeEnvelope($11, $12, $13, $14)
        and not exists (
            select from conetl.feature_version a
            where a.feature_id = b.feature_id and a.present
            and a.valid_period @> (select $4) and a.system_period @> (select $5)
        )
    ) c
    where
        ($7 <= -180 and $8 <= -90 and $9 >= 180 and $10 >= 90)
        or (
            ST_Y(ST_Transform(c.place, 4326)) between $8 - 5e-10 and $10 + 5e-10
            and case
                when $7 <= $9 then ST_X(ST_Transform(c.place, 4326)) between $7 - 5e-10 and $9 + 5e-10
                else ST_X(ST_Transform(c.place, 4326)) >= $7 - 5e-10 or ST_X(ST_Transform(c.place, 4326)) <= $9 + 5e-10
            end
        )
$$;
comment on function conetl_ogc.changes is 'How a map differs between two instants on the road, each as the database knew it.';
