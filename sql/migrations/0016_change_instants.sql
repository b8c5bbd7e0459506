-- Purpose: changes between two instants name the instant of the change, also where the cone was confirmed in between.
--
-- An added or moved cone had the beginning of its newest version, a removed one the end of the version that stood at from_at: each
-- confirmation makes a version, so this was the last or the first confirmation. Now added is the beginning of the first version that
-- stood since from_at, moved that of the first one so far from the old place, removed the end of the last one that began until to_at, all
-- as believed at known_to; confirmed is the newest confirmation, as before. Null: by what is believed at known_to it never stood.
--
-- Versions are looked up for rows that are returned only: the column stands outside of the union, where a page's limit comes before it.
create or replace function conetl_ogc.changes(
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
        c.feature_id, c.kind,
        case c.kind
            when 'confirmed' then c.valid_from
            when 'removed' then (
                select max(upper(v.valid_period))
                from conetl.feature_version v
                where v.cell = c.cell and v.feature_id = c.feature_id and v.present
                and lower(v.valid_period) <= (select $4) and v.system_period @> (select $5)
            )
            else (
                select min(lower(v.valid_period))
                from conetl.feature_version v
                where v.cell = c.cell and v.feature_id = c.feature_id and v.present
                and (v.valid_period @> (select $2) or lower(v.valid_period) between (select $2) and (select $4))
                and v.system_period @> (select $5)
                and (c.kind = 'added' or ST_Distance(v.geom, c.old_place) >= $6)
            )
        end,
        c.shift_m, c.category,
        ST_X(c.place), ST_Y(c.place), ST_Z(c.place),
        ST_X(c.old_place), ST_Y(c.old_place), ST_Z(c.old_place),
        c.existence_probability, c.observation_count, c.cone_height_m, c.version,
        ST_Transform(c.place, 4326)
    from (
        select
            a.cell, a.feature_id,
            case
                when b.feature_id is null then 'added'
                when ST_Distance(a.geom, b.geom) >= $6 then 'moved'
                else 'confirmed'
            end as kind,
            lower(a.valid_period) as valid_from,
            ST_Distance(a.geom, b.geom) as shift_m,
            a.category, a.geom as place, b.geom as old_place, a.existence_probability, a.observation_count, a.cone_height_m, a.version
        from conetl.map m
        join conetl.feature_version a using (map_id)
        left join conetl.feature_version b
            on b.cell = a.cell and b.feature_id = a.feature_id and b.present
            and b.valid_period @> (select $2) and b.system_period @> (select $3)
        where m.map_name = $1 and a.present
        and a.valid_period @> (select $4) and a.system_period @> (select $5)
        and (b.feature_id is null or a.version <> b.version or not ST_Equals(a.geom, b.geom))
        and a.geom && ST_MakeEnvelope($11, $12, $13, $14)
        union all
        select
            b.cell, b.feature_id, 'removed', lower(b.valid_period), null,
            b.category, b.geom, b.geom, b.existence_probability, b.observation_count, b.cone_height_m, b.version
        from conetl.map m
        join conetl.feature_version b using (map_id)
        where m.map_name = $1 and b.present
        and b.valid_period @> (select $2) and b.system_period @> (select $3)
        and b.geom && ST_MakeEnvelope($11, $12, $13, $14)
        and not exists (
            select from conetl.feature_version a
            where a.cell = b.cell and a.feature_id = b.feature_id and a.present
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
