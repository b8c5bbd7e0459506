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

-- name: page
-- One page of items as GeoJSON made by PostgreSQL, so that items are sent to the client without unpacking.
-- Parameters: $1 limit, $2 offset; $3, $4 text before and after the id in the links of each item; then those of the call.
-- Placeholders: {{call}} (of a function of conetl_ogc, for points of standing where neither the condition nor the order needs
-- evidence), {{where}}, {{order}}, evidence (columns.evidence, or nothing for changes), {{properties}} (columns of p, and of the
-- evidence). Columns: items (with commas, in order; null: none), returned (number of items).
with page as materialized (
    select s.*, row_number() over () as item_no
    from (
        select *
        from {{call}}
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
{{evidence}}
cross join lateral (select {{properties}}) r;

-- name: features_found
-- Which versions are on a page of features out of many, and how many there are on all pages, in one pass over the
-- table. The page itself is read afterwards (ogc.page): here a row is narrow, so that a million of them can be
-- stored for counting.
-- Parameters: $1 limit, $2 offset; then those of the call. Placeholders: {{call}} (of conetl_ogc.standing; by_place true: by the
-- index of positions, false: through the whole table), {{where}}, {{order}}.
-- Columns: version_row_id (in order), matched (the same in all rows).
select s.version_row_id, count(*) over () as matched
from {{call}} s
{{where}}
order by {{order}}
limit $1 offset $2;

-- name: count
-- How many items there are on all pages. Parameters: those of the call. Placeholders: {{call}}, {{where}}, as for ogc.page.
-- Columns: matched.
select count(*) as matched
from {{call}}
{{where}};
