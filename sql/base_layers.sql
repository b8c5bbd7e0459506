-- Base layers under the cones: point clouds and lines, each with the file that it came from.

-- name: find_source
-- The import of this file with these parameters, if there was one.
-- Parameters: map_name; layer_name; content_sha256; params (JSON). Columns: kept_count.
select s.kept_count
from conetl.base_source s
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and s.layer_name = %(layer_name)s and s.content_sha256 = %(content_sha256)s
and s.params = %(params)s::jsonb;

-- name: insert_source
-- One imported file of a base layer, unless it exists. Parameters: as the columns; map_name; corners of the extent (map CRS).
-- Columns: source_id (no row where another import was faster).
insert into conetl.base_source (
    source_id, map_id, srid, layer_name, kind, source_path, content_sha256, params, source_crs, read_count, kept_count,
    refused_count, heights, extent
)
select
    %(source_id)s, m.map_id, m.srid, %(layer_name)s, %(kind)s, %(source_path)s, %(content_sha256)s, %(params)s::jsonb,
    %(source_crs)s, %(read_count)s, %(kept_count)s, %(refused_count)s, %(heights)s,
    ST_MakeEnvelope(%(west_m)s, %(south_m)s, %(east_m)s, %(north_m)s, m.srid)
from conetl.map m
where m.map_name = %(map_name)s
on conflict do nothing
returning source_id;

-- name: drop_older_source
-- Drop what was imported from an earlier state of the same file.
-- Parameters: map_name; layer_name; source_path; source_id (stays).
delete from conetl.base_source s
using conetl.map m
where m.map_id = s.map_id and m.map_name = %(map_name)s and s.layer_name = %(layer_name)s
and s.source_path = %(source_path)s and s.source_id <> %(source_id)s;

-- name: drop_layer
-- Drop a base layer with all its files. Parameters: map_name; layer_name. Columns: kept_count of each file.
delete from conetl.base_source s
using conetl.map m
where m.map_id = s.map_id and m.map_name = %(map_name)s and s.layer_name = %(layer_name)s
returning s.kept_count;

-- name: sources
-- The imported files of a map's base layers. Parameters: map_name.
-- Columns: as below; extent in the map's CRS, bytes of tiles as stored.
select
    s.source_id, s.layer_name, s.kind, s.source_path, s.content_sha256, s.params, s.source_crs,
    s.read_count, s.kept_count, s.refused_count, s.heights, s.imported_at,
    ST_XMin(s.extent) as west_m, ST_YMin(s.extent) as south_m, ST_XMax(s.extent) as east_m, ST_YMax(s.extent) as north_m,
    (select coalesce(sum(octet_length(t.payload)), 0) from conetl.base_tile t where t.source_id = s.source_id)::bigint as bytes
from conetl.base_source s
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by s.layer_name, s.imported_at, s.source_id;

-- name: poses
-- Positions of the body along the drives of a map, thinned to about max_rows.
-- Parameters: map_name; max_rows. Columns: easting_m, northing_m, height_m.
with pose as (
    select f.geom, row_number() over (order by f.drive_uuid, f.frame_index) as n, count(*) over () as pose_count
    from conetl.frame_pair f
    join conetl.drive d using (drive_uuid)
    join conetl.map m using (map_id)
    where m.map_name = %(map_name)s
)
select ST_X(geom) as easting_m, ST_Y(geom) as northing_m, ST_Z(geom) as height_m
from pose
where n %% greatest(1, pose_count / %(max_rows)s) = 0;

-- name: feet
-- Feet of standing cones, which show the height of the road.
-- Parameters: map_name; max_rows. Columns: easting_m, northing_m, height_m.
select easting_m, northing_m, ellipsoidal_height_m as height_m
from conetl.current_feature
where map_name = %(map_name)s
order by feature_id
limit %(max_rows)s;

-- name: ingested_poses
-- The poses (refined ones where they were refined) of an ingested drive's body, of its last analysis.
-- Parameters: map_name; content_sha256.
select f.frame_index, ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as height_m, f.map_r_body
from conetl.frame_pair f
where f.drive_uuid = (
    select d.drive_uuid
    from conetl.drive d
    join conetl.map m using (map_id)
    join conetl.changeset c using (drive_uuid)
    where m.map_name = %(map_name)s and d.content_sha256 = %(content_sha256)s
    order by c.changeset_no desc
    limit 1
)
order by f.frame_index;

-- name: lines_near
-- Lines of a map's base layers inside boxes, a row per line and box. Parameters: map_name; west_m, south_m, east_m, north_m
-- (float8[] of equal lengths, map CRS), one entry per box. Columns: box from 0; geom in well-known binary.
select b.number - 1 as box, s.layer_name, l.kind, l.attributes, ST_AsBinary(ST_Force2D(l.geom)) as geom
from unnest(%(west_m)s::float8[], %(south_m)s::float8[], %(east_m)s::float8[], %(north_m)s::float8[])
    with ordinality as b (west_m, south_m, east_m, north_m, number)
cross join conetl.map m
join conetl.base_source s on s.map_id = m.map_id and s.kind = 'lines'
join conetl.base_line l on l.source_id = s.source_id
    and l.geom && ST_MakeEnvelope(b.west_m, b.south_m, b.east_m, b.north_m, m.srid)
where m.map_name = %(map_name)s
order by b.number, l.line_id;

-- name: lines
-- The lines of a map's base layers, in well-known binary; subtype is null where there is none. Parameters: map_name; max_rows.
select s.layer_name, l.kind, l.attributes ->> 'subtype' as subtype, ST_AsBinary(l.geom) as geom
from conetl.base_line l
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by l.line_id
limit %(max_rows)s;

-- name: tiles
-- The point tiles of a map, coarse ones first.
-- Parameters: map_name; max_rows. Columns: level, points, origin_m, scale_m (3 each), high_m, sha256.
select t.level, t.points, t.origin_m, t.scale_m, t.high_m, t.sha256
from conetl.base_tile t
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by t.level, s.source_id, t.ix, t.iy
limit %(max_rows)s;

-- name: tile
-- The bytes of one point tile of a map. Parameters: map_name; sha256. Columns: payload.
select t.payload
from conetl.base_tile t
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where t.sha256 = %(sha256)s and m.map_name = %(map_name)s
limit 1;
