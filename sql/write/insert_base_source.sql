-- Purpose: one imported file of a base layer, unless it is there. Parameters: source_id; map_name; layer_name; kind; source_path;
-- content_sha256; params (JSON); source_crs; read_count; kept_count; refused_count; heights; west_m, south_m, east_m, north_m.
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
