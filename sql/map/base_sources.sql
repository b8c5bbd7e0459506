-- Purpose: the imported files of a map's base layers. Parameters: map_name.
-- Columns: source_id, layer_name, kind, source_path, content_sha256, params, source_crs, read_count, kept_count, refused_count, heights,
-- imported_at, west_m, south_m, east_m, north_m (map's CRS), bytes (of tiles, compressed).
select
    s.source_id, s.layer_name, s.kind, s.source_path, s.content_sha256, s.params, s.source_crs,
    s.read_count, s.kept_count, s.refused_count, s.heights, s.imported_at,
    ST_XMin(s.extent) as west_m, ST_YMin(s.extent) as south_m, ST_XMax(s.extent) as east_m, ST_YMax(s.extent) as north_m,
    (select coalesce(sum(octet_length(t.payload)), 0) from conetl.base_tile t where t.source_id = s.source_id)::bigint as bytes
from conetl.base_source s
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by s.layer_name, s.imported_at, s.source_id;
