-- Purpose: boxes that hold most of a large map answered by OGC API Features without a transformation to degrees for every cone in them.
--
-- A box has a third form, an inner box in the map's CRS (inner_min_x_m .. inner_max_y_m) that surely lies inside the one in degrees: what
-- stands in it needs no other test. Only what lies between the inner box and the one that finds the rows is transformed, by the same
-- expressions as before (0009). An inner box that holds nothing, the default, leaves every row to them, and so the answer is the same.
--
-- by_place false, written as such into a statement, is a plan that reads the whole table: for most of it that takes less time than
-- the index of places, and a plan that is made once a session cannot know how much a box holds. The box in the map's CRS then still keeps
-- rows from being transformed.
--
-- standing also names the row of each version, by which a page is fetched once it is known which versions are on it.

drop function conetl_ogc.features(
    text, timestamptz, timestamptz, timestamptz, float8, float8, float8, float8, float8, float8, float8, float8
);
drop function conetl_ogc.standing(
    text, timestamptz, timestamptz, timestamptz, float8, float8, float8, float8, float8, float8, float8, float8
);

create function conetl_ogc.standing(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30,
    inner_min_x_m float8 default 1e30, inner_min_y_m float8 default 1e30,
    inner_max_x_m float8 default -1e30, inner_max_y_m float8 default -1e30,
    by_place boolean default true
)
returns table (
    feature_id uuid, version integer, category text, existence_probability float8,
    easting_m float8, northing_m float8, height_m float8,
    sigma_east_m float8, sigma_north_m float8, sigma_height_m float8, cov_xy_m2 float8,
    cone_height_m float8, cone_height_sigma_m float8, observation_count integer,
    first_seen_at timestamptz, last_seen_at timestamptz, valid_from timestamptz, valid_to timestamptz,
    geom geometry, version_row_id bigint
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
        ST_Transform(v.geom, 4326), v.version_row_id
    from conetl.map m
    join conetl.feature_version v using (map_id)
    where m.map_name = $1 and v.present
    and v.valid_period && (select tstzrange($2, $3, '[]')) and v.system_period @> (select $4)
    and (
        (select $2 = $3) or not exists (
            select from conetl.feature_version later
            where later.cell = v.cell and later.feature_id = v.feature_id and later.present and later.valid_period && (select tstzrange($2, $3, '[]'))
            and later.system_period @> (select $4) and lower(later.valid_period) > lower(v.valid_period)
        )
    )
    and (not $17 or v.geom && ST_MakeEnvelope($9, $10, $11, $12))
    and (
        ($5 <= -180 and $6 <= -90 and $7 >= 180 and $8 >= 90)
        or (ST_X(v.geom) between $13 and $15 and ST_Y(v.geom) between $14 and $16)
        or (
            ST_X(v.geom) between $9 and $11 and ST_Y(v.geom) between $10 and $12
            and ST_Y(ST_Transform(v.geom, 4326)) between $6 - 5e-10 and $8 + 5e-10
            and case
                when $5 <= $7 then ST_X(ST_Transform(v.geom, 4326)) between $5 - 5e-10 and $7 + 5e-10
                else ST_X(ST_Transform(v.geom, 4326)) >= $5 - 5e-10 or ST_X(ST_Transform(v.geom, 4326)) <= $7 + 5e-10
            end
        )
    )
$$;
comment on function conetl_ogc.standing is
    'The cones of a map that stood between two instants on the road, as the database knew it; existence_probability is that of the version.';

create function conetl_ogc.features(
    map_name text,
    from_at timestamptz default 'infinity', to_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    west float8 default -180, south float8 default -90, east float8 default 180, north float8 default 90,
    min_x_m float8 default -1e30, min_y_m float8 default -1e30, max_x_m float8 default 1e30, max_y_m float8 default 1e30,
    inner_min_x_m float8 default 1e30, inner_min_y_m float8 default 1e30,
    inner_max_x_m float8 default -1e30, inner_max_y_m float8 default -1e30
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
                where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
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
            where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive'
        ),
        (
            select count(*)::integer
            from conetl.delta x
            where x.cell = f.cell and x.feature_id = s.feature_id and x.changed_at <= (select $3) and x.system_period @> (select $4)
            and x.kind in ('missed', 'removed')
        ),
        s.first_seen_at, s.last_seen_at, s.valid_from, s.valid_to, s.geom
    from conetl_ogc.standing($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16) s
    join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0
$$;
comment on function conetl_ogc.features is 'The cones of a map that stood between two instants on the road, as the database knew it.';
