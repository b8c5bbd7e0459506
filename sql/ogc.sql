-- What OGC API Features reads beside tipg's own queries. Parameters are those of asyncpg.

-- name: maps
-- Maps that hold something, for the collections. Parameters: $1 name of one map, null for all.
-- Columns: map_name, srid, changeset_no (the newest), last_committed_at (of changesets and decisions, as map.find_map:
-- both change the map).
select
    m.map_name, m.srid, c.changeset_no,
    greatest(c.committed_at, (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)) as last_committed_at
from conetl.map m
join lateral (
    select x.changeset_no, x.committed_at
    from conetl.changeset x
    where x.map_id = m.map_id
    order by x.committed_at desc
    limit 1
) c on true
where $1::text is null or m.map_name = $1
order by m.map_name;

-- name: extent
-- Extent and beginning of a map. Parameters: $1 map name.
-- Columns: west, south, east, north (degrees; around the areas of all drives), since (beginning of the first drive),
-- share (of this map in all versions of features of the database), version_count (of this map): both as PostgreSQL last
-- estimated them for its plans, 0 without an estimate.
select
    ST_XMin(a.box) as west, ST_YMin(a.box) as south, ST_XMax(a.box) as east, ST_YMax(a.box) as north, a.since,
    coalesce(s.share, 0)::float8 as share, coalesce(s.share * s.row_count, 0)::float8 as version_count
from (
    select
        ST_Extent(ST_Transform(ST_Segmentize(e.edges, greatest(ST_Perimeter(e.edges) / 64, 1)), 4326)) as box,
        min(e.since) as since
    from (
        select ST_Envelope(d.area) as edges, lower(d.captured_period) as since
        from conetl.drive d
        join conetl.map m using (map_id)
        where m.map_name = $1
    ) e
) a
left join (
    select f.share, c.reltuples as row_count
    from conetl.map m
    join pg_class c on c.oid = 'conetl.feature_version'::regclass
    join pg_stats p on p.schemaname = 'conetl' and p.tablename = 'feature_version' and p.attname = 'map_id'
    join unnest(p.most_common_vals::text::integer[], p.most_common_freqs) f (map_id, share) using (map_id)
    where m.map_name = $1
) s on true;

-- name: features_page
-- One page of features of a map as GeoJSON made by PostgreSQL, so that items are sent to the client without unpacking.
-- Parameters: $1 limit, $2 offset; $3, $4 text before and after the id in the links of each item; $5 map name; $6, $7,
-- $8 from_at, to_at, known_at (text of instants); then those of the box, or nothing for all of the map, or the rows of
-- versions that {{where}} names.
-- Placeholders: {{source}} (conetl_ogc.lane_markings; of points conetl_ogc.standing, or conetl_ogc.features where the
-- condition or the order needs its evidence), {{box}} (its named arguments, each after a comma), {{where}}, {{order}}, {{properties}} (columns of p, n
-- and e). Columns: items (with commas, in order; null: none), returned (number of items).
-- Evidence is that of conetl.feature_evidence, looked up after the limit and for all items at once; existence after a
-- miss only where there is a miss. The full join finds what a left join would, because n has no other features, but it
-- is always hashed or merged, where a planner who expects one item would read n once per item.
with page as materialized (
    select s.*, row_number() over () as item_no
    from (
        select *
        from {{source}}($5, $6::text::timestamptz, $7::text::timestamptz, $8::text::timestamptz{{box}})
        {{where}}
        order by {{order}}
        limit $1 offset $2
    ) s
)
select
    string_agg(
        '{"type":"Feature","geometry":' || ST_AsGeoJSON(p.geom) || ',"id":"' || p.feature_id
        || '","properties":' || row_to_json(r) || ',"links":' || $3::text || p.feature_id || $4::text || '}',
        ',' order by p.item_no
    ) as items,
    count(*)::integer as returned
from page p
full join (
    select
        x.feature_id,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer as missed_count,
        count(*) filter (
            where x.kind not in ('missed', 'removed', 'merged') and x.changeset_id not in (
                select i.changeset_id from conetl.drive d join conetl.changeset i using (drive_uuid) where d.kind <> 'drive'
            )
        )::integer as seen_count
    from page p
    join conetl.feature f on f.feature_id = p.feature_id and f.map_id > 0
    join conetl.delta x on x.cell = f.cell and x.feature_id = f.feature_id
    where x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
    group by x.feature_id
) n on n.feature_id = p.feature_id
cross join lateral (
    select
        case when n.missed_count > 0 then (
            select x.existence_after
            from conetl.delta x
            join conetl.changeset c using (changeset_id)
            join conetl.drive d using (drive_uuid)
            where x.cell = conetl.cell_of(p.feature_id) and x.feature_id = p.feature_id and x.old_version = p.version
            and x.kind = 'missed'
            and x.changed_at <= (select $7::text::timestamptz) and x.system_period @> (select $8::text::timestamptz)
            order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            limit 1
        ) end as existence_after
) e
cross join lateral (select {{properties}}) r;

-- name: features_found
-- Which versions are on a page of features out of many, and how many there are on all pages, in one pass over the
-- table. The page itself is read afterwards (features_page): here a row is narrow, so that a million of them can be
-- stored for counting.
-- Parameters: $1 limit, $2 offset; $3 map name; $4, $5, $6 from_at, to_at, known_at (text of instants); then those of
-- the box.
-- Placeholders: {{box}} (named arguments of conetl_ogc.standing, each after a comma), {{by_place}} (true: by the index
-- of positions, false: through the whole table), {{where}}, {{order}}.
-- Columns: version_row_id (in order), matched (the same in all rows).
select s.version_row_id, count(*) over () as matched
from conetl_ogc.standing($3, $4::text::timestamptz, $5::text::timestamptz, $6::text::timestamptz{{box}}, by_place => {{by_place}}) s
{{where}}
order by {{order}}
limit $1 offset $2;

-- name: features_count
-- How many features of a map there are on all pages.
-- Parameters: $1 map name; $2, $3, $4 from_at, to_at, known_at (text of instants); then those of the box.
-- Placeholders: {{source}} (as for features_page; conetl_ogc.features looks up every feature once more), {{box}} (its
-- named arguments, each after a comma), {{where}}.
-- Columns: matched.
select count(*) as matched
from {{source}}($1, $2::text::timestamptz, $3::text::timestamptz, $4::text::timestamptz{{box}})
{{where}};

-- name: changes_page
-- One page of changes of a map as GeoJSON made by PostgreSQL, so that items are sent to the client without unpacking.
-- Parameters: $1 limit, $2 offset; $3, $4 text before and after the id in the links of each item; $5 map name; $6, $7,
-- $8, $9 from_at, known_from, to_at, known_to (text of instants); $10 moved_from_m (m); then the box in both forms, as
-- conetl_ogc.changes has them, or nothing for all of the map.
-- Placeholders: {{box}} (named arguments, each after a comma), {{where}}, {{order}}, {{properties}} (columns of p).
-- Columns: items (with commas, in order; null: none), returned (number of items).
with page as materialized (
    select s.*, row_number() over () as item_no
    from (
        select *
        from conetl_ogc.changes(
            $5, $6::text::timestamptz, $7::text::timestamptz, $8::text::timestamptz, $9::text::timestamptz, $10{{box}}
        )
        {{where}}
        order by {{order}}
        limit $1 offset $2
    ) s
)
select
    string_agg(
        '{"type":"Feature","geometry":' || ST_AsGeoJSON(p.geom) || ',"id":"' || p.feature_id
        || '","properties":' || row_to_json(r) || ',"links":' || $3::text || p.feature_id || $4::text || '}',
        ',' order by p.item_no
    ) as items,
    count(*)::integer as returned
from page p
cross join lateral (select {{properties}}) r;
