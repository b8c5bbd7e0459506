-- What OGC API Features reads beside tipg's own queries. Parameters are those of asyncpg.

-- name: maps
-- Maps, for the collections. Parameters: $1 name of one map, null for all.
-- Columns: map_name, srid, changeset_no (the newest, 0: none), last_written_at (see conetl.newest_write).
select
    m.map_name, m.srid, coalesce(c.changeset_no, 0) as changeset_no, conetl.newest_write(m.map_id) as last_written_at
from conetl.map m
left join lateral (
    select x.changeset_no
    from conetl.changeset x
    where x.map_id = m.map_id
    order by x.committed_at desc
    limit 1
) c on true
where $1::text is null or m.map_name = $1
order by m.map_name;

-- name: extent
-- Extent and beginning of a map. Parameters: $1 map name.
-- Columns: west, south, east, north (degrees; around the areas of all drives; null: none), west_360, east_360 (the same counted from 0
-- to 360), since (beginning of the first drive, or creation of the map), share (of this map in all versions of features of the database), version_count (of this map): both as
-- PostgreSQL last estimated them for its plans, 0 without an estimate.
select
    ST_XMin(a.box) as west, ST_YMin(a.box) as south, ST_XMax(a.box) as east, ST_YMax(a.box) as north,
    ST_XMin(a.shifted) as west_360, ST_XMax(a.shifted) as east_360,
    coalesce(a.since, m.created_at) as since,
    coalesce(s.share, 0)::float8 as share, coalesce(s.share * s.row_count, 0)::float8 as version_count
from conetl.map m
cross join lateral (
    select ST_Extent(e.edges) as box, ST_Extent(ST_ShiftLongitude(e.edges)) as shifted, min(e.since) as since
    from (
        select
            ST_Transform(ST_Segmentize(b.box, greatest(ST_Perimeter(b.box) / 64, 1)), 4326) as edges,
            lower(d.captured_period) as since
        from conetl.drive d
        cross join lateral (select ST_Envelope(d.area) as box) b
        where d.map_id = m.map_id
    ) e
) a
left join (
    select f.map_id, f.share, c.reltuples as row_count
    from pg_class c
    join pg_stats p on p.schemaname = 'conetl' and p.tablename = 'feature_version' and p.attname = 'map_id'
    cross join unnest(p.most_common_vals::text::integer[], p.most_common_freqs) f (map_id, share)
    where c.oid = 'conetl.feature_version'::regclass
) s on s.map_id = m.map_id
where m.map_name = $1;

-- name: features
-- Rows of a collection of point objects. Placeholders: {{arguments}} (of conetl.feature_states), {{where}} (about s).
select {{ogc_points columns of s}}, ST_Transform(s.geom, 4326) as geom, s.version_row_id
from conetl.feature_states({{arguments}}) s
where s.line is null and {{where}};

-- name: lane_markings
-- Rows of a collection of lane markings. Placeholders: as features.
select {{ogc_lines columns of s}}, ST_Transform(s.line, 4326) as geom, s.version_row_id
from conetl.feature_states({{arguments}}) s
where s.line is not null and {{where}};

-- name: changes
-- Rows of a collection of changes of point objects. Placeholders: {{arguments}} (of conetl.feature_changes), {{where}} (about s).
-- offset 0: the planner expects few changes, and would read all features of a box anew for each.
select {{ogc_changes columns of s}}, {{of_changes columns of c}}, ST_Transform(s.geom, 4326) as geom, s.version_row_id
from conetl.feature_changes({{arguments}}) c
cross join lateral (select f.* from conetl.feature_state f where f.version_row_id = c.version_row_id offset 0) s
where not c.is_line and {{where}};

-- name: differences
-- Rows of a collection of differences between planned and found work zones, which Python computes. Placeholders: {{rows}} (JSON),
-- {{columns}} (of them, with types), {{west}}, {{south}}, {{east}}, {{north}} (of a box in degrees; west > east crosses 180 degrees).
select r.*, r.difference_id as feature_id, ST_SetSRID(ST_MakePoint(r.lon_deg, r.lat_deg), 4326) as geom
from jsonb_to_recordset({{rows}}) r ({{columns}})
where r.lat_deg between {{south}} - 5e-10 and {{north}} + 5e-10
and case
    when {{west}} <= {{east}} then r.lon_deg between {{west}} - 5e-10 and {{east}} + 5e-10
    else r.lon_deg >= {{west}} - 5e-10 or r.lon_deg <= {{east}} + 5e-10
end;

-- name: point_in_box
-- Whether a point is in a box in degrees, edges included (west > east crosses 180 degrees). GeoJSON prints billionths of a degree (a
-- tenth of a millimetre), and the edge of a box is as exact: a coordinate of an answer as the edge of a box finds that item. Only what
-- is between a box around it and one inside it, both in the map's CRS, is transformed to degrees. Placeholders: the sides of the boxes.
(ST_X(s.geom) between {{inner_min_x_m}} and {{inner_max_x_m}} and ST_Y(s.geom) between {{inner_min_y_m}} and {{inner_max_y_m}})
or (
    ST_X(s.geom) between {{min_x_m}} and {{max_x_m}} and ST_Y(s.geom) between {{min_y_m}} and {{max_y_m}}
    and ST_Y(ST_Transform(s.geom, 4326)) between {{south}} - 5e-10 and {{north}} + 5e-10
    and case
        when {{west}} <= {{east}} then ST_X(ST_Transform(s.geom, 4326)) between {{west}} - 5e-10 and {{east}} + 5e-10
        else ST_X(ST_Transform(s.geom, 4326)) >= {{west}} - 5e-10 or ST_X(ST_Transform(s.geom, 4326)) <= {{east}} + 5e-10
    end
);

-- name: line_in_box
-- Whether a line meets a box in degrees. Placeholders: as point_in_box.
ST_Intersects(
    ST_Transform(s.line, 4326),
    case
        when {{west}} <= {{east}}
            then ST_MakeEnvelope({{west}} - 5e-10, {{south}} - 5e-10, {{east}} + 5e-10, {{north}} + 5e-10, 4326)
        else ST_Collect(
            ST_MakeEnvelope({{west}} - 5e-10, {{south}} - 5e-10, 180, {{north}} + 5e-10, 4326),
            ST_MakeEnvelope(-180, {{south}} - 5e-10, {{east}} + 5e-10, {{north}} + 5e-10, 4326)
        )
    end
);

-- name: page
-- One page of items as GeoJSON made by PostgreSQL, so that items are sent to the client without unpacking.
-- Parameters: $1 limit, $2 offset; $3, $4 text before and after the id in the links of each item; then those of the source.
-- Placeholders: {{source}} (rows of a collection), {{where}}, {{order}}, {{columns}} (that these and the items need),
-- {{properties}} (columns of p). Columns: items (with commas, in order; null: none), returned (number of items).
with page as materialized (
    select s.*, row_number() over () as item_no
    from (
        select {{columns}}
        from {{source}}
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

-- name: items_found
-- Which rows are on a page of many, and how many there are on all pages, in one pass over the table. The page itself is read afterwards
-- (page): here a row is narrow, so that a million of them can be stored for counting.
-- Parameters: $1 limit, $2 offset; then those of the source. Placeholders: as page.
-- Columns: version_row_id (in order), matched (the same in all rows).
select version_row_id, count(*) over () as matched
from {{source}}
{{where}}
order by {{order}}
limit $1 offset $2;

-- name: count
-- How many items there are on all pages. Parameters: those of the source. Placeholders: as page. Columns: matched.
select count(*) as matched
from {{source}}
{{where}};

-- name: stored_clusters
-- The clusters of a vector tile of the map now: the cells of conetl.feature_cell, each in the tile that its mean position is in.
-- Parameters: $1 map name; $2, $3 valid_at, known_at (timestamptz; null: latest); $4 zoom of the cells; $5 to $8 smallest and largest
-- easting and northing (a box around the tile); $9 to $12 the same of the tile in Web Mercator.
-- Columns: tile; feature_count (of the cells in the box, at least as many as in the tile); is_now (whether the state is that of now, which
-- the cells are of).
with cells as materialized (
    select c.category, c.feature_count, ST_Transform(ST_SetSRID(
        ST_MakePoint(c.sum_cm[1] / c.feature_count / 100.0, c.sum_cm[2] / c.feature_count / 100.0), m.srid
    ), 3857) as at
    from conetl.map m
    join conetl.feature_cell c using (map_id)
    where m.map_name = $1 and c.zoom = $4::integer and not c.is_line and c.feature_count > 0
    and (c.x + 1) * 2 ^ (20 - c.zoom) >= $5::float8 and (c.y + 1) * 2 ^ (20 - c.zoom) >= $6::float8
    and c.x * 2 ^ (20 - c.zoom) <= $7::float8 and c.y * 2 ^ (20 - c.zoom) <= $8::float8
)
select
    (
        select ST_AsMVT(t.*, 'default')
        from (
            select
                c.category, c.feature_count,
                ST_AsMVTGeom(c.at, ST_MakeEnvelope($9::float8, $10::float8, $11::float8, $12::float8, 3857)::box2d, 4096, 0) as geom
            from cells c
        ) t
        where t.geom is not null
    ) as tile,
    (select coalesce(sum(c.feature_count), 0)::bigint from cells c) as feature_count,
    conetl.is_now($1, coalesce($2::timestamptz, 'infinity'), coalesce($3::timestamptz, 'infinity')) as is_now;

-- name: counted_clusters
-- The clusters of a vector tile of any rows, in squares of a 32nd of the tile. Parameters: $1 to $4 smallest and largest easting and
-- northing of the tile in Web Mercator; then those of the source. Placeholders: as page; {{columns}} (that clusters have besides their
-- number). Columns: tile; feature_count (of all clusters).
with clusters as materialized (
    select {{columns}}, count(*)::integer as feature_count, ST_SetSRID(ST_MakePoint(avg(ST_X(p.at)), avg(ST_Y(p.at))), 3857) as at
    from (select items.*, ST_Transform(ST_Centroid(items.geom), 3857) as at from {{source}} {{where}}) p
    group by {{columns}}, floor((ST_X(p.at) - $1::float8) / ($3::float8 - $1::float8) * 32), floor((ST_Y(p.at) - $2::float8) / ($4::float8 - $2::float8) * 32)
)
select
    (
        select ST_AsMVT(t.*, 'default')
        from (
            select
                {{columns}}, c.feature_count,
                ST_AsMVTGeom(c.at, ST_MakeEnvelope($1::float8, $2::float8, $3::float8, $4::float8, 3857)::box2d, 4096, 0) as geom
            from clusters c
        ) t
        where t.geom is not null
    ) as tile,
    (select coalesce(sum(c.feature_count), 0)::bigint from clusters c) as feature_count;
