-- Purpose: what belongs to a stretch of road lies together in every index, so that a drive into a map of ten million features reads
-- a few pages of each and not one page a feature.
--
-- Ids are hashes (UUIDv5 of the founding evidence): in an index on ids the features of one road lie on as many pages as there are
-- features, and each is a wait for the disk when the road was not visited lately. So each feature keeps the cell of 256 m in which it
-- was founded, forever, and keys begin with it. The cell is the database's own affair: no record, export or id knows it.
--
-- Constraints stay as strong as they were. conetl.feature has one row an id (feature_by_id), so an id has one cell, and
-- foreign keys carry it into versions and deltas: two rows with the same id have the same cell, and (cell, id) is the same or different
-- exactly where the id is. Whoever knows an id only, asks conetl.feature for its cell.

-- South to north in rows of cells, west to east within a row. Numbers beyond all maps are cut off instead of being refused here.
create function conetl.place_cell(place geometry) returns bigint
language sql immutable strict parallel safe
as $$
    select
        (least(greatest(floor(ST_Y(place) / 256), -1073741824), 1073741824)::bigint << 32)
        + least(greatest(floor(ST_X(place) / 256), -1073741824), 1073741824)::bigint
$$;
comment on function conetl.place_cell is 'The square of 256 m (map CRS) in which a point lies, as one number; neighbours have near numbers.';

-- Tables are written anew by a change of type: an update would leave them at twice their size.
drop function conetl.map_as_of(text, timestamptz, timestamptz);
drop view conetl.current_feature;
alter table conetl.delta drop constraint delta_feature_id_fkey;
alter table conetl.feature_version drop constraint feature_version_feature_id_map_id_srid_fkey;
alter table conetl.feature drop constraint feature_feature_id_map_id_srid_key;
drop index conetl.delta_by_feature, conetl.delta_missed;

create function conetl.founding_cell(id uuid) returns bigint
language sql stable
as $$
    select coalesce(
        (
            select conetl.place_cell(v.geom) from conetl.feature_version v
            where v.feature_id = id
            order by v.version, v.version_row_id
            limit 1
        ),
        0
    )
$$;
alter table conetl.feature add column cell bigint;
alter table conetl.feature alter column cell type bigint using conetl.founding_cell(feature_id);
alter table conetl.feature alter column cell set not null;
drop function conetl.founding_cell(uuid);
comment on column conetl.feature.cell is 'Cell of 256 m in which it was founded (conetl.place_cell); never changes, wherever it is moved.';

alter table conetl.feature_version drop constraint no_overlap;
drop index conetl.feature_version_believed;
create function conetl.cell_of_feature(id uuid) returns bigint
language sql stable
as $$
    select f.cell from conetl.feature f where f.feature_id = id
$$;
alter table conetl.feature_version add column cell bigint;
alter table conetl.feature_version alter column cell type bigint using conetl.cell_of_feature(feature_id);
alter table conetl.feature_version alter column cell set not null;
alter table conetl.delta add column cell bigint;
alter table conetl.delta alter column cell type bigint using conetl.cell_of_feature(feature_id);
alter table conetl.delta alter column cell set not null;
drop function conetl.cell_of_feature(uuid);

-- One row an id. The condition holds for every row, and keeps the planner from this index where a cell is known: it costs as much in its
-- eyes, and checks of foreign keys would go by it. So whoever asks by id alone says "and map_id > 0", or calls conetl.cell_of.
alter table conetl.feature add constraint map_ids_are_positive check (map_id > 0);
create unique index feature_by_id on conetl.feature (feature_id) where map_id > 0;
alter table conetl.feature drop constraint feature_pkey;
alter table conetl.feature add primary key (cell, feature_id);
alter table conetl.feature add unique (cell, feature_id, map_id, srid);
create function conetl.cell_of(feature_id uuid) returns bigint
language sql stable parallel safe
as $$
    select f.cell from conetl.feature f where f.feature_id = $1 and f.map_id > 0
$$;
comment on function conetl.cell_of is 'The cell in which a feature was founded, which keys begin with; null where there is no such feature.';
create unique index feature_version_believed
    on conetl.feature_version (cell, feature_id, version, coalesce(upper(system_period), 'infinity'));
alter table conetl.feature_version add constraint no_overlap
    exclude using gist (cell with =, feature_id with =, valid_period with &&) where (upper_inf(system_period));
create index delta_by_feature on conetl.delta (cell, feature_id);
create index delta_missed on conetl.delta (cell, feature_id, old_version) where kind = 'missed' and upper_inf(system_period);
alter table conetl.feature_version add constraint feature_of_version foreign key (cell, feature_id, map_id, srid)
    references conetl.feature (cell, feature_id, map_id, srid);
alter table conetl.delta add constraint feature_of_delta foreign key (cell, feature_id) references conetl.feature (cell, feature_id);

-- What stands around a road that runs obliquely: the box around the whole of its area may hold a hundred times as much. Pieces are made
-- by numbers of vertices, so a straight road gets some first: a piece is at most some 1.5 km of it.
create function conetl.pieces(area geometry) returns setof geometry
language sql immutable parallel safe rows 1
as $$
    select area where 4 * ST_Area(area) >= ST_Area(ST_Envelope(area))
    union all
    select p.piece from ST_Subdivide(ST_Segmentize(area, 50), 64) p (piece) where 4 * ST_Area(area) < ST_Area(ST_Envelope(area))
$$;
comment on function conetl.pieces is
    'An area, cut up where its bounding box is more than four times as large, for indexes that know boxes only. Pieces share their edges.';

create view conetl.current_feature as
select m.map_name, v.*
from conetl.feature_version v
join conetl.map m using (map_id)
where upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present;
comment on view conetl.current_feature is 'The map as it is now, as the database knows it now; one row per standing cone.';

create function conetl.map_as_of(map_name text, valid_at timestamptz, known_at timestamptz default 'infinity')
returns setof conetl.current_feature
language sql stable
as $$
    select m.map_name, v.*
    from conetl.feature_version v
    join conetl.map m using (map_id)
    where m.map_name = $1 and v.present and v.valid_period @> $2 and v.system_period @> $3
$$;
comment on function conetl.map_as_of is
    'The map of the instant valid_at as the database knew it at known_at; infinity means latest.';

-- The functions that look up versions or deltas by feature: as they were (0007, 0009, 0012), with the feature's cell.
create or replace function conetl.feature_evidence(
    feature_id uuid, version integer, valid_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    out seen_count integer, out missed_count integer, out existence_after float8
)
language sql stable
as $$
    select
        count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive')::integer,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer,
        (
            array_agg(
                x.existence_after
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            ) filter (where x.kind = 'missed' and x.old_version = $2)
        )[1]
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where x.cell = conetl.cell_of($1)
    and x.feature_id = $1 and x.changed_at <= $3 and x.system_period @> $4
$$;

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
            on b.cell = a.cell and b.feature_id = a.feature_id and b.present
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

create or replace function conetl_ogc.standing(
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
            where later.cell = v.cell and later.feature_id = v.feature_id and later.present and later.valid_period && (select tstzrange($2, $3, '[]'))
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
    from conetl_ogc.standing($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12) s
    join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0
$$;
