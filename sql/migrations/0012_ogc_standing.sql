-- Purpose: which cones OGC API Features shows, apart from the evidence for each, so that a page looks the evidence up for its own items.
--
-- conetl_ogc.standing says which features stood in a box between two instants and what their versions say; conetl_ogc.features is that
-- with belief and counts of drives, one look at the deltas per row and column, for those who filter and order by them. Units, the two
-- forms of a box and its tolerance as in 0009.

create function conetl_ogc.standing(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    easting_m float8, northing_m float8, height_m float8,
    sigma_east_m float8, sigma_north_m float8, sigma_height_m float8, cov_xy_m2 float8,
    cone_height_m float8, cone_height_sigma_m float8, observation_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry
)
language sql stable
as $$
    select
        v.feature_id, v.version, v.category, v.existence_probability,
        ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
        sqrt(v.cov_xx), sqrt(v.cov_yy), sqrt(v.cov_zz), v.cov_xy,
        v.cone_height_m, v.cone_height_sigma_m, v.observation_count,
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
comment on function conetl_ogc.standing is
    'The cones of a map that stood between two instants on the road, as the database knew it; existence_probability is that of the version.';

create or replace function conetl_ogc.features(
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
        s.feature_id, s.version, s.category,
        coalesce(
            (
                select x.existence_after
                from conetl.delta x
                join conetl.changeset c using (changeset_id)
                join conetl.drive d using (drive_uuid)
                where x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
                and x.kind = 'missed' and x.old_version = s.version
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
                limit 1
            ),
            s.existence_probability
        ),
        s.easting_m, s.northing_m, s.height_m, s.sigma_east_m, s.sigma_north_m, s.sigma_height_m, s.cov_xy_m2,
        s.cone_height_m, s.cone_height_sigma_m, s.observation_count,
        (
            select count(*)::integer
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive'
        ),
        (
            select count(*)::integer
            from conetl.delta x
            where x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind in ('missed', 'removed')
        ),
        s.first_seen_at, s.last_seen_at, s.valid_from, s.valid_to, s.geom
    from conetl_ogc.standing($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12) s
$$;
